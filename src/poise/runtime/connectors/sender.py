"""The source's end of a connector: one to the component, whatever route it takes.

While a component moves, the sender buffers messages, and then switches routes, so that
each takes exactly one, in order. No lock is held while a route sends, and a thread
sends what was buffered: no step of a move waits for a receiver.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from math import nan
from typing import Any

from poise import threads
from poise.errors import CallError, RunError, Sparing, Timeout, Unavailable
from poise.runtime.component.ports import Port
from poise.runtime.connectors.interface import (
    Method,
    Proxy,
    carries_messages,
    methods,
    oneway_function,
    refusing,
)
from poise.runtime.connectors.latest import LatestMessage, Number, Numbered
from poise.runtime.connectors.route import Route
from poise.runtime.connectors.tap import (
    ObservedPort,
    Observers,
    observed_call,
    observed_send,
)
from poise.runtime.execution.container_lease import LeaseEnded
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.data_age import SentChains, Stamped
from poise.runtime.execution.exclusion import Exclusion, stepping_out
from poise.runtime.execution.mailbox import MOST_AHEAD
from poise.wire.codec import WireError

log = logging.getLogger(__name__)

_WHILE_MOVING = 2
"""The number of routes while the target moves: one to either incarnation."""
_ASK_FIRST, _ASK_LAST = 0.005, 0.1
"""A sender without room asks for it after this time, and then ever less often [s]."""

MOST_BUFFERED = MOST_AHEAD
"""Messages that a sender buffers while a component moves; then publishers wait."""
Waiting = tuple[Method | None, Any, float]
"""A one-way call's method, what is sent, and since when it waits [s, monotonic]."""


class Sender(ObservedPort):
    """The source's end of one connector. Any thread may use it."""

    def __init__(
        self,
        name: str,
        port: Port,
        proxy: Proxy | None,
        limit: float,
        exclusion: Exclusion | None = None,
        chains: SentChains | None = None,
        latest: LatestMessage | None = None,
    ) -> None:
        super().__init__(port, latest)
        self.name = name
        self.chains = chains
        self.counts = Counts()
        self._sparing = Sparing(log)
        self._limit = limit
        self._methods = tuple(methods(port.type).values()) if proxy else ()
        self._proxy = proxy
        self._exclusion = exclusion
        self._routes: dict[str, Route] = {}
        self._current: Route | None = None
        self._buffer: deque[Waiting] | None = None
        self._source_is_inactive = self._target_moves = False
        self._is_claimed = self._is_draining = False
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._num_waiting = 0
        with self._lock:
            self._use(None)

    def add(self, key: str, route: Route) -> None:
        """Add a route; the first is used at once."""
        with self._lock:
            self._routes[key] = route
            if self._current is None:
                self._use(route)
                self.offer_latest(route)

    def remove(self, key: str) -> None:
        """Close a route; when it was used, use the other one, if there is one."""
        with self._lock:
            route = self._routes.pop(key)
            if route is self._current:
                self._use(next(iter(self._routes.values()), None))
            self._target_moves = False
            self._drain()
        route.close()

    def routes(self) -> dict[str, Route]:
        """Return the routes by key."""
        return dict(self._routes)

    def sending(self) -> Callable[..., None]:
        """Return `send` with stamps, which are made at once: waiting counts as age."""
        chains, send = self.chains, self.send
        if chains is not None and chains.carries:
            send = chains.stamping(send)
        return observed_send(send, self._observers) if self._observers else send

    def observe(self, observers: Observers) -> None:
        """Let observers note what goes out from now on, instead of those before."""
        super().observe(observers)
        with self._lock:
            self._use(self._current)

    def send(self, value: object, method: Method | None = None) -> None:
        """Send or buffer a message or one-way call; what cannot go out is counted."""
        if self._exclusion is None or self._can_take():
            self._send(value, method)
        else:
            stepping_out(self._exclusion, self._send)(value, method)

    def buffer_for_move(self, keep: int | None = None) -> None:
        """Buffer messages from now on; from a cut-off target, the `keep` newest."""
        with self._lock:
            if len(self._routes) < _WHILE_MOVING:
                raise RunError(f"connector {self.name}: its target does not move")
            self._target_moves = True
            buffer = self._begin_to_buffer()
            if keep is not None:
                self.counts.drops += max(0, len(buffer) - keep)
                self._buffer = deque(buffer, keep)

    def buffer_until_active(self) -> None:
        """Buffer messages until `send_buffered`: the source is not active yet."""
        with self._lock:
            self._source_is_inactive = True
            self._begin_to_buffer()

    def send_buffered(self) -> None:
        """Send what was buffered, and buffer no more; harmless when repeated."""
        with self._lock:
            self._source_is_inactive = False
            self._drain()

    def switch(self, key: str) -> None:
        """Use a route, and send what was buffered; harmless when repeated."""
        with self._lock:
            if key not in self._routes:
                raise Unavailable(f"connector {self.name} has no route {key}")
            self._use(self._routes[key])
            self._target_moves = False
            self._drain()

    def has_left(self) -> bool:
        """Return whether no call waits at a former target any more."""
        others = (r for r in self.routes().values() if r is not self._current)
        return not any(route.is_calling() for route in others)

    def send_marker(self, number: int) -> None:
        """Send a marker behind all messages that went out, within `limit` [s].

        Where only calls go out there are none: those in progress end before a pause.
        """
        if not carries_messages(self.port):
            return
        with self._lock:
            if not self._wait(
                lambda: not (self._is_claimed or self._is_draining), self._limit
            ):
                text = f"has been sending for {self._limit:g} s"
                raise Timeout(f"connector {self.name} {text}")
            route = self._claim()
        try:
            if route is None:
                raise Unavailable(f"connector {self.name} has no receiver")
            route.send_marker(number)
        finally:
            self._release()

    def repeat_call(
        self,
        route: Route,
        name: str,
        args: tuple[object, ...],
        kwargs: Mapping[str, object],
        deadline: float,
    ) -> Any:  # noqa: ANN401, the call's own
        """Repeat a call that `route` did not run on another, until `deadline` [s]."""
        with self._lock:
            left = deadline - time.monotonic()
            if not self._wait(lambda: self._current is not route, left):
                self.counts.add_call(0.0, failed=True)
                raise Timeout(
                    f"connector {self.name}: its target has failed or did not come back"
                )
        return getattr(self._proxy, name)(*args, **kwargs)

    def note_room(self) -> None:
        """Wake senders that wait for room: the target may have some."""
        with self._lock:
            self._changed.notify_all()

    def offer_latest(self, route: Route | None, heard: Number | None = None) -> None:
        """Let a thread send the last message again to a target that has not got it.

        `heard`: the number of the last one that it has; None: it is asked.
        """
        last = self.last
        if last is None or route is None or (heard and heard >= last.number):
            return
        if not self._num_waiting:  # else a publisher is about to send it
            threads.daemon(self._offer_latest, "latest", route, heard).start()

    def _send(self, value: object, method: Method | None) -> None:
        began = time.monotonic()
        with self._lock:  # every message comes this way: no call more than needed
            is_free = self._can_take()
            if is_free:
                if self._buffer is not None:
                    self._hold(self._buffer, (method, value, began))
                    return
                route = self._claim()
        if is_free:
            self._push(route, method, value, began)
        else:
            self._send_late(value, method, began)

    def _send_late(self, value: object, method: Method | None, began: float) -> None:
        """Send or buffer a message as soon as it may go; drop it after the limit."""
        deadline, pause = began + self._limit, _ASK_FIRST
        while True:
            left = deadline - time.monotonic()
            with self._lock:
                if self._wait(self._can_take, min(pause, left)):
                    if self._buffer is not None:
                        self._hold(self._buffer, (method, value, began))
                        return
                    route = self._claim()
                    break
            if left <= pause:
                self.counts.drops += 1
                text = "connector %s: no room for %g s, a message is dropped"
                self._sparing.warn("dropped", text, self.name, self._limit)
                return
            if not self._ask_for_room():
                self.counts.drops += 1
                return
            pause = min(2 * pause, _ASK_LAST)
        self._push(route, method, value, began)

    def _offer_latest(self, route: Route, heard: Number | None) -> None:
        # one that is not there is asked as soon as it is
        if heard is None and not route.try_connect():
            return
        with self._lock:
            is_free = self._wait(self._can_take, self._limit)
            is_current = self._current is route and self._buffer is None
            if not is_free or not is_current:  # what ends that offers it, too
                return
            self._claim()
        try:
            if heard is None:
                heard = route.ask()
            last = self.last
            if heard is not None and last is not None and last.number > heard:
                self.counts.add_message(
                    route.push(None, self._marked_as_repeated(last))
                )
        except (CallError, WireError) as error:
            log.debug("connector %s: %s", self.name, error)
        finally:
            self._release()

    def _marked_as_repeated(self, last: Numbered) -> Numbered | Stamped:
        """Return a message as it is sent again: how old its data is is not known."""
        again = last._replace(is_again=True)
        chains = self.chains.carries if self.chains else ()
        return Stamped(chains, (nan,) * len(chains), again) if chains else again

    def _can_take(self) -> bool:
        """Return whether a message may be sent or buffered now."""
        if self._buffer is not None:
            return len(self._buffer) < MOST_BUFFERED
        if self._is_claimed:
            return False
        return self._current is None or self._current.has_room()

    def _wait(self, holds: Callable[[], bool], limit: float) -> bool:
        self._num_waiting += 1
        try:
            return self._changed.wait_for(holds, limit)
        finally:
            self._num_waiting -= 1

    def _claim(self) -> Route | None:
        self._is_claimed = True
        return self._current

    def _release(self) -> None:
        with self._lock:
            self._is_claimed = False
            if self._num_waiting:
                self._changed.notify_all()

    def _ask_for_room(self) -> bool:
        """Ask the target for room, unless another thread sends; whether it is there."""
        with self._lock:
            route = self._current
            if self._is_claimed or self._buffer is not None or route is None:
                return True
            self._is_claimed = True
        try:
            route.ask()
        except CallError as error:
            log.debug("connector %s: %s", self.name, error)
            return False
        finally:
            self._release()
        return True

    def _hold(self, buffer: deque[Waiting], waiting: Waiting) -> None:
        """Buffer a message, in place of the oldest where only the newest are kept."""
        self.counts.drops += len(buffer) == buffer.maxlen
        buffer.append(waiting)

    def _begin_to_buffer(self) -> deque[Waiting]:
        if self._buffer is None:
            self._buffer = deque()
            self._changed.notify_all()
        return self._buffer

    def _drain(self) -> None:
        """Send what was buffered, if nothing speaks against it, and buffer no more."""
        if self._may_drain() and not self._is_draining:
            if self._buffer:
                threads.daemon(self._flush, "drain").start()
                self._is_draining = True
            else:
                self._buffer = None
                self._changed.notify_all()
                self.offer_latest(self._current)

    def _may_drain(self) -> bool:
        return not self._target_moves and not self._source_is_inactive

    def _flush(self) -> None:
        while True:
            with self._lock:
                self._wait(lambda: not self._is_claimed, self._limit)
                if not self._buffer or not self._may_drain():
                    self._is_draining = False
                    self._drain()
                    self._changed.notify_all()
                    return
                if self._is_claimed:
                    continue
                route = self._claim()
                method, value, began = self._buffer.popleft()
            try:
                self._push(route, method, value, began)
            # its publisher has gone on, and the messages behind it have to go out
            except Exception as error:  # noqa: BLE001
                self.counts.drops += not isinstance(error, LeaseEnded)  # it is counted
                log.warning("connector %s: a message is dropped: %r", self.name, error)

    def _push(
        self, route: Route | None, method: Method | None, value: object, began: float
    ) -> None:
        """Send a message that has claimed the sender, and release that."""
        try:
            if route is None:
                self.counts.drops += 1
                return
            size = route.push(method, value)
            self.counts.add_message(size)
            if size:  # within a container they wait only where they end
                self.counts.wait.add(time.monotonic() - began)
        except CallError as error:
            self.counts.drops += 1
            if isinstance(error, LeaseEnded):  # its publisher is to know
                raise
            log.debug("connector %s: %s", self.name, error)
        finally:
            self._release()

    def _use(self, route: Route | None) -> None:
        self._current = route
        self._changed.notify_all()
        for method in self._methods:
            setattr(self._proxy, method.name, self._function(method, route))

    def _function(self, method: Method, route: Route | None) -> Callable[..., Any]:
        if route is None:
            return refusing(self.name)
        if method.oneway:
            return oneway_function(method, self.sending())
        call = route.function(method, self)
        if self._exclusion is not None:
            call = stepping_out(self._exclusion, call)
        if self._observers:
            call = observed_call(call, method.name, self._observers)
        return call
