"""The source's end of a connector: one to the component, whatever path it takes.

A path leads to one incarnation of the target, directly or over a pipe. While a
component moves there are two paths; the outlet holds messages meanwhile and then
switches, so that every message goes over exactly one of them, in order.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NoReturn, Protocol

from poise.errors import CallError, RunError, Timeout, Unavailable
from poise.model.suggest import did_you_mean, listed
from poise.runtime.component.error_report import Sparing
from poise.runtime.component.ports import Port
from poise.runtime.connectors.interface import Method, methods
from poise.runtime.connectors.reentrant import stepping_out
from poise.runtime.execution.connector_counters import Counts
from poise.runtime.execution.exclusion import Turn
from poise.wire.codec import WireError

log = logging.getLogger(__name__)

_WHILE_MOVING = 2
"""So many paths an outlet has while its target moves: to either incarnation."""
MOST_HELD = 5_000
"""Messages that wait in an outlet while a component moves; then publishers wait."""


_ASK_FIRST, _ASK_LAST = 0.005, 0.1
"""Whoever waits for room asks for it after this time, and then ever less often [s]."""


class Path(Protocol):
    """A way to one incarnation of the target."""

    def is_ready(self) -> bool:
        """Return at once whether the other end is there."""
        ...

    def function(self, method: Method, sender: Sender) -> Callable[..., Any]:
        """Return the function that calls a method of the target.

        It calls `Sender.again` when the target has moved and did not run the call.
        """
        ...

    def push(self, method: Method | None, value: object) -> int:
        """Send a message, or a one-way call of `method`; return its size [bytes].

        Raises
        ------
        CallError
            It did not go out.
        """
        ...

    def has_room(self) -> bool:
        """Return at once whether the target has room for one more message."""
        ...

    def ask(self) -> None:
        """Ask for room, in case that the news of it got lost; raises as `push`."""
        ...

    def mark(self, number: int) -> None:
        """Send a mark, which gets there after all that was pushed; raises as `push`."""
        ...

    def close(self) -> None:
        """Give back what it holds; harmless when repeated."""
        ...


class Facade:
    """What a required port holds: the interface's methods as attributes."""

    def __init__(self, what: str) -> None:
        self._what = what

    def __getattr__(self, name: str) -> NoReturn:
        """Say which methods there are; only asked for one that is not."""
        known = [each for each in vars(self) if not each.startswith("_")]
        raise AttributeError(
            f"{self._what} has no method '{name}'{did_you_mean(name, known)}; "
            f"methods: {listed(known)}"
        )


class Sender:
    """The source's end of one connector.

    Parameters
    ----------
    name
        The connector's name.
    port
        The source's port.
    facade
        For a required port: where its methods are.
    limit
        Time limit of a call, and of a message that waits [s].
    turn
        Of a re-entrant source: let go while it waits in a call.
    """

    def __init__(
        self,
        name: str,
        port: Port,
        facade: Facade | None,
        limit: float,
        turn: Turn | None = None,
    ) -> None:
        self.name = name
        self.port = port
        self.counts = Counts()
        self._sparing = Sparing()
        self._limit = limit
        self._methods = tuple(methods(port.type).values()) if facade else ()
        self._facade = facade
        self._turn = turn
        self._paths: dict[str, Path] = {}
        self._current: Path | None = None
        self._held: deque[tuple[Method | None, object, float]] | None = None
        self._is_kept_back = self._target_moves = False
        self._changed = threading.Condition()
        self._disconnect()

    def add(self, key: str, path: Path) -> None:
        """Know one more path; the first is used at once."""
        with self._changed:
            self._paths[key] = path
            if self._current is None:
                self._use(path)

    def remove(self, key: str) -> None:
        """Close a path; when it was used, another one is, if there is one.

        The move for which there were two is over, and what was held goes out: so no
        message waits for ever for a `release` that got lost.
        """
        with self._changed:
            path = self._paths.pop(key)
            if path is self._current:
                self._use(next(iter(self._paths.values()), None))
            self._target_moves = False
            self._send_held()
        path.close()

    def paths(self) -> dict[str, Path]:
        """Return the known paths by key."""
        return dict(self._paths)

    def send(self, value: object, method: Method | None = None) -> None:
        """Send a message or one-way call, or hold it; what cannot go out is counted.

        Waits while the target has no room, up to the limit; a re-entrant source lets
        others in meanwhile.
        """
        if self._turn is None or self._has_room():
            self._send(value, method)
        else:
            stepping_out(self._turn, self._send)(value, method)

    def _send(self, value: object, method: Method | None) -> None:
        began = time.monotonic()
        with self._changed:
            if not self._has_room() and not self._wait_for_room(began + self._limit):
                self.counts.drops += 1
                more = self._sparing.more("dropped", time.monotonic())
                if more is not None:
                    text = "connector %s: no room for %g s, a message is dropped%s"
                    log.warning(text, self.name, self._limit, more)
            elif self._held is None:
                self._push(method, value, began)
            else:
                self._held.append((method, value, began))

    def hold(self) -> None:
        """Hold messages from now on; harmless when repeated.

        Raises
        ------
        RunError
            There is one path: no move is going on, or it is over and the order is late.
        """
        with self._changed:
            if len(self._paths) < _WHILE_MOVING:
                raise RunError(
                    f"connector {self.name} has nothing to hold messages for"
                )
            self._target_moves = True
            self._begin_to_hold()

    def keep_back(self) -> None:
        """Hold messages until `let_go`: the source is not at work yet."""
        with self._changed:
            self._is_kept_back = True
            self._begin_to_hold()

    def let_go(self) -> None:
        """Send what was kept back, and keep no more; harmless when repeated."""
        with self._changed:
            self._is_kept_back = False
            self._send_held()

    def release(self, key: str) -> None:
        """Use a path, send what was held, and hold no more; harmless when repeated.

        Raises
        ------
        Unavailable
            There is no such path; all is as it was.
        """
        with self._changed:
            if key not in self._paths:
                raise Unavailable(f"connector {self.name} has no path {key}")
            self._use(self._paths[key])
            self._target_moves = False
            self._send_held()

    def mark(self, number: int) -> None:
        """Send a mark behind all that went out.

        Raises
        ------
        Unavailable
            Nobody is there who could take it.
        """
        with self._changed:
            if self._current is None or not self._current.is_ready():
                raise Unavailable(f"connector {self.name} has nobody at its other end")
            self._current.mark(number)

    def again(
        self,
        path: Path,
        name: str,
        args: tuple[object, ...],
        kwargs: Mapping[str, object],
        deadline: float,
    ) -> Any:  # noqa: ANN401, the call's own
        """Repeat a call that `path` did not run, once another path is used.

        Raises
        ------
        Timeout
            None was until `deadline` [s, of the monotonic clock].
        """
        with self._changed:
            left = deadline - time.monotonic()
            if not self._changed.wait_for(lambda: self._current is not path, left):
                raise Timeout(f"connector {self.name}: its target did not come back")
        return getattr(self._facade, name)(*args, **kwargs)

    def close(self) -> None:
        """Close every path."""
        for key in list(self._paths):
            self.remove(key)

    def room(self) -> None:
        """Let those go on who wait for room: the target may have some."""
        with self._changed:
            self._changed.notify_all()

    def _has_room(self) -> bool:
        if self._held is not None:
            return len(self._held) < MOST_HELD
        return self._current is None or self._current.has_room()

    def _wait_for_room(self, deadline: float) -> bool:
        pause = _ASK_FIRST
        while True:
            left = deadline - time.monotonic()
            if self._changed.wait_for(self._has_room, min(pause, left)):
                return True
            if left <= pause:
                return False
            pause = min(2 * pause, _ASK_LAST)
            try:
                if self._held is None and self._current is not None:
                    self._current.ask()
            except CallError:
                return True  # nobody is there: to send it will tell so

    def _begin_to_hold(self) -> None:
        if self._held is None:
            self._held = deque()
            self._changed.notify_all()

    def _send_held(self) -> None:
        if self._target_moves or self._is_kept_back:
            return
        while self._held:
            method, value, began = self._held.popleft()
            try:
                self._push(method, value, began)
            except WireError as error:  # nobody is there to be told: it was taken
                self.counts.drops += 1
                log.warning("connector %s: a message is dropped: %s", self.name, error)
        self._held = None
        self._changed.notify_all()

    def _push(self, method: Method | None, value: object, began: float) -> None:
        if self._current is None:
            self.counts.drops += 1
            return
        try:
            size = self._current.push(method, value)
        except CallError as error:
            self.counts.drops += 1
            log.debug("connector %s: %s", self.name, error)
            return
        self.counts.add_message(size)
        if size:  # within a container they wait only where they end
            self.counts.wait.add(time.monotonic() - began)

    def _use(self, path: Path | None) -> None:
        self._current = path
        self._changed.notify_all()
        if path is None:
            self._disconnect()
            return
        for method in self._methods:
            setattr(self._facade, method.name, self._function(method, path))

    def _function(self, method: Method, path: Path) -> Callable[..., Any]:
        if method.oneway:
            return _sender(self, method)
        call = path.function(method, self)
        return call if self._turn is None else stepping_out(self._turn, call)

    def _disconnect(self) -> None:
        for method in self._methods:
            setattr(self._facade, method.name, refusing(self.name))


def refusing(what: str) -> Callable[..., NoReturn]:
    """Return a function that raises `Unavailable`, however it is called."""

    def call(*_: object, **__: object) -> NoReturn:
        raise Unavailable(f"'{what}' is not connected")

    return call


def _sender(sender: Sender, method: Method) -> Callable[..., None]:
    def call(*args: Any, **kwargs: Any) -> None:  # noqa: ANN401, the call's own
        sender.send(method.bind(*args, **kwargs), method)

    return call
