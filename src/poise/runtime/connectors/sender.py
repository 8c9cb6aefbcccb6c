"""The source's end of a connector: one to the component, whatever route it takes.

A route leads to one incarnation of the target, directly or over a pipe. While a
component moves there are two routes; the outlet holds messages meanwhile and then
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
from poise.runtime.execution.exclusion import Exclusion
from poise.wire.codec import WireError

log = logging.getLogger(__name__)

_WHILE_MOVING = 2
"""So many routes an outlet has while its target moves: to either incarnation."""
MOST_BUFFERED = 5_000
"""Messages that wait in an outlet while a component moves; then publishers wait."""


_ASK_FIRST, _ASK_LAST = 0.005, 0.1
"""Whoever waits for room asks for it after this time, and then ever less often [s]."""


class Route(Protocol):
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

    def send_marker(self, number: int) -> None:
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
    exclusion
        Of a re-entrant source: let go while it waits in a call.
    """

    def __init__(
        self,
        name: str,
        port: Port,
        facade: Facade | None,
        limit: float,
        exclusion: Exclusion | None = None,
    ) -> None:
        self.name = name
        self.port = port
        self.counts = Counts()
        self._sparing = Sparing()
        self._limit = limit
        self._methods = tuple(methods(port.type).values()) if facade else ()
        self._facade = facade
        self._exclusion = exclusion
        self._routes: dict[str, Route] = {}
        self._current: Route | None = None
        self._buffer: deque[tuple[Method | None, object, float]] | None = None
        self._source_is_inactive = self._target_moves = False
        self._changed = threading.Condition()
        self._disconnect()

    def add(self, key: str, route: Route) -> None:
        """Know one more route; the first is used at once."""
        with self._changed:
            self._routes[key] = route
            if self._current is None:
                self._use(route)

    def remove(self, key: str) -> None:
        """Close a route; when it was used, another one is, if there is one.

        The move for which there were two is over, and what was held goes out: so no
        message waits for ever for a `release` that got lost.
        """
        with self._changed:
            route = self._routes.pop(key)
            if route is self._current:
                self._use(next(iter(self._routes.values()), None))
            self._target_moves = False
            self._drain()
        route.close()

    def routes(self) -> dict[str, Route]:
        """Return the known routes by key."""
        return dict(self._routes)

    def send(self, value: object, method: Method | None = None) -> None:
        """Send a message or one-way call, or hold it; what cannot go out is counted.

        Waits while the target has no room, up to the limit; a re-entrant source lets
        others in meanwhile.
        """
        if self._exclusion is None or self._has_room():
            self._send(value, method)
        else:
            stepping_out(self._exclusion, self._send)(value, method)

    def _send(self, value: object, method: Method | None) -> None:
        began = time.monotonic()
        with self._changed:
            if not self._has_room() and not self._wait_for_room(began + self._limit):
                self.counts.drops += 1
                more = self._sparing.more("dropped", time.monotonic())
                if more is not None:
                    text = "connector %s: no room for %g s, a message is dropped%s"
                    log.warning(text, self.name, self._limit, more)
            elif self._buffer is None:
                self._push(method, value, began)
            else:
                self._buffer.append((method, value, began))

    def buffer_for_move(self) -> None:
        """Hold messages from now on; harmless when repeated.

        Raises
        ------
        RunError
            There is only one route: no move is going on.
        """
        with self._changed:
            if len(self._routes) < _WHILE_MOVING:
                raise RunError(f"connector {self.name}: its target does not move")
            self._target_moves = True
            self._begin_to_buffer()

    def buffer_until_active(self) -> None:
        """Hold messages until `let_go`: the source is not at work yet."""
        with self._changed:
            self._source_is_inactive = True
            self._begin_to_buffer()

    def send_buffered(self) -> None:
        """Send what was kept back, and keep no more; harmless when repeated."""
        with self._changed:
            self._source_is_inactive = False
            self._drain()

    def switch(self, key: str) -> None:
        """Use a route, send what was held, and hold no more; harmless when repeated.

        Raises
        ------
        Unavailable
            There is no such route; all is as it was.
        """
        with self._changed:
            if key not in self._routes:
                raise Unavailable(f"connector {self.name} has no route {key}")
            self._use(self._routes[key])
            self._target_moves = False
            self._drain()

    def send_marker(self, number: int) -> None:
        """Send a mark behind all that went out.

        Raises
        ------
        Unavailable
            Nobody is there who could take it.
        """
        with self._changed:
            if self._current is None or not self._current.is_ready():
                raise Unavailable(f"connector {self.name} has nobody at its other end")
            self._current.send_marker(number)

    def again(
        self,
        route: Route,
        name: str,
        args: tuple[object, ...],
        kwargs: Mapping[str, object],
        deadline: float,
    ) -> Any:  # noqa: ANN401, the call's own
        """Repeat a call that `route` did not run, once another route is used.

        Raises
        ------
        Timeout
            None was until `deadline` [s, of the monotonic clock].
        """
        with self._changed:
            left = deadline - time.monotonic()
            if not self._changed.wait_for(lambda: self._current is not route, left):
                raise Timeout(f"connector {self.name}: its target did not come back")
        return getattr(self._facade, name)(*args, **kwargs)

    def close(self) -> None:
        """Close every route."""
        for key in list(self._routes):
            self.remove(key)

    def room(self) -> None:
        """Let those go on who wait for room: the target may have some."""
        with self._changed:
            self._changed.notify_all()

    def _has_room(self) -> bool:
        if self._buffer is not None:
            return len(self._buffer) < MOST_BUFFERED
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
                if self._buffer is None and self._current is not None:
                    self._current.ask()
            except CallError:
                return True  # nobody is there: to send it will tell so

    def _begin_to_buffer(self) -> None:
        if self._buffer is None:
            self._buffer = deque()
            self._changed.notify_all()

    def _drain(self) -> None:
        if self._target_moves or self._source_is_inactive:
            return
        while self._buffer:
            method, value, began = self._buffer.popleft()
            try:
                self._push(method, value, began)
            except WireError as error:  # nobody is there to be told: it was taken
                self.counts.drops += 1
                log.warning("connector %s: a message is dropped: %s", self.name, error)
        self._buffer = None
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

    def _use(self, route: Route | None) -> None:
        self._current = route
        self._changed.notify_all()
        if route is None:
            self._disconnect()
            return
        for method in self._methods:
            setattr(self._facade, method.name, self._function(method, route))

    def _function(self, method: Method, route: Route) -> Callable[..., Any]:
        if method.oneway:
            return _sender(self, method)
        call = route.function(method, self)
        return call if self._exclusion is None else stepping_out(self._exclusion, call)

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
