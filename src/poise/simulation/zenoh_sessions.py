"""Sessions that behave as zenoh's do, over the simulated network.

As in Poise's use of zenoh, a session talks with those that it connected to, or that
connected to it, and passes nothing on. The end of a process is seen at once: its kernel
says so. A frozen process, or a cut, is seen only by the silence, after the timeout.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, Self

import zenoh

from poise.endpoint import Endpoint
from poise.simulation.network import Addresses, Network
from poise.simulation.robot.simulated_process import Process

_FIRST_RETRY, _LONGEST_RETRY = 0.05, 0.5
"""As `poise.wire.control_session` sets them [s]."""
_TIMEOUT = 10.0


class ZenohNetwork:
    """The sessions of all processes."""

    def __init__(self, network: Network, addresses: Addresses) -> None:
        self.network = network
        self.addresses = addresses
        self._sessions: list[Session] = []

    def open(self, process: Process, config: zenoh.Config) -> Session:
        """Open a session, as `zenoh.open` does."""
        timeout = float(config.get_json("transport/link/tx/lease")) / 1000
        listen = json.loads(config.get_json("listen/endpoints"))
        connect = json.loads(config.get_json("connect/endpoints"))
        for locator in listen:
            if self.listening(locator) is not None:
                raise zenoh.ZError(f"[{locator}: Address already in use (os error 98)]")
        session = Session(self, process, listen, timeout or _TIMEOUT)
        self._sessions.append(session)
        for locator in connect:
            self._connect(session, locator, 0.0, _FIRST_RETRY)
        process.on_end.append(session.die)
        return session

    def listening(self, locator: str) -> Session | None:
        """Return the session that listens at a locator."""
        return next((s for s in self._sessions if locator in s.listen), None)

    def forget(self, session: Session) -> None:
        """Let a session be gone."""
        if session in self._sessions:
            self._sessions.remove(session)

    def probe(
        self, process: Process, address: tuple[str, int], limit: float
    ) -> SimpleNamespace:
        """Connect to an address, as `socket.create_connection` does."""
        here, there = process.computer.name, self.addresses.hosts.get(address[0])
        cut = self.network.is_cut
        if there is None or cut(here, there) or cut(there, here):
            process.scheduler.wait(limit, "a connection")
            raise TimeoutError
        process.scheduler.wait(2 * self.network.model.latency, "a connection")
        if self.listening(f"tcp/{Endpoint(*address)}") is None:
            raise ConnectionRefusedError
        return SimpleNamespace(close=lambda: None)

    def _connect(
        self, session: Session, locator: str, pause: float, retry: float
    ) -> None:
        def attempt() -> None:
            if session.is_closed:
                return
            other = self.listening(locator)
            if other is None or not self._meet(session, other):
                longer = min(2 * retry, _LONGEST_RETRY)
                self._connect(session, locator, retry, longer)
                return

            def again() -> None:
                self._connect(session, locator, _FIRST_RETRY, _FIRST_RETRY)

            SimulatedConnection(self.network, session, other, again)

        scheduler = self.network.scheduler
        later = pause * self.network.choices.between("network", 0.5, 1.0)
        round_trip = 3 * self.network.model.latency
        scheduler.at(scheduler.now + later + round_trip, attempt)

    def _meet(self, one: Session, other: Session) -> bool:
        here, there = one.process.computer.name, other.process.computer.name
        cut = self.network.is_cut
        is_paused = one.process.is_paused or other.process.is_paused
        return not (is_paused or cut(here, there) or cut(there, here))


class Session:
    """A process's session; what Poise uses of `zenoh.Session`."""

    def __init__(
        self, of: ZenohNetwork, process: Process, listen: list[str], timeout: float
    ) -> None:
        self.process = process
        self.listen = listen
        self.timeout = timeout
        self.is_closed = False
        self.sides: list[Side] = []
        self.tokens: list[str] = []
        self.info = SimpleNamespace(declare_link_events_listener=lambda *_, **__: None)
        self._of = of
        self._subscribers: list[_Declared] = []
        self._watchers: list[_Declared] = []
        self._queryables: list[_Declared] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all connections, as a process's end does."""
        self.is_closed = True
        self._of.forget(self)
        for side in list(self.sides):
            side.connection.close(side, is_told=True)

    def die(self) -> None:
        """End with its process: the kernel closes its connections."""
        if not self.is_closed:
            self.close()

    def liveliness(self) -> SimpleNamespace:
        """Return what declares tokens and watches them."""
        return SimpleNamespace(
            declare_token=self._declare_token, declare_subscriber=self._watch
        )

    def declare_subscriber(
        self, key: str, callback: Callable[[Any], object]
    ) -> _Declared:
        """Take what others put at matching keys."""
        return _Declared(self._subscribers, key, callback)

    def declare_queryable(
        self, key: str, callback: Callable[[Any], object]
    ) -> _Declared:
        """Answer what others ask at a key."""
        return _Declared(self._queryables, key, callback)

    def declare_publisher(self, key: str, **_: object) -> SimpleNamespace:
        """Return what puts at a key."""
        return SimpleNamespace(put=lambda data: self._put(key, data))

    def get(
        self,
        key: str,
        handler: Callable[[Any], object],
        *,
        payload: bytes,
        timeout: float,
    ) -> None:
        """Ask whom the key reaches; `handler.drop` is called after the last reply."""
        side = next((s for s in self.sides if s.other.session.queryable(key)), None)
        if side is None:
            self.process.spawn("zenoh", handler.drop)  # type: ignore[attr-defined]
            return
        side.ask(key, handler, payload, timeout)

    def queryable(self, key: str) -> Callable[[Any], object] | None:
        """Return what answers at a key."""
        return next((d.callback for d in self._queryables if matches(d.key, key)), None)

    def receive_put(self, key: str, data: bytes) -> None:
        """Give subscribers what another session put; on the process's own task."""
        for subscriber in list(self._subscribers):
            if matches(subscriber.key, key):
                subscriber.callback(_sample(key, zenoh.SampleKind.PUT, data))

    def note_token(self, key: str, kind: zenoh.SampleKind) -> None:
        """Tell watchers of a token that came or went; on the process's own task."""
        for watcher in list(self._watchers):
            if matches(watcher.key, key):
                watcher.callback(_sample(key, kind))

    def _put(self, key: str, data: bytes) -> None:
        for side in list(self.sides):
            callback = partial(side.other.session.receive_put, key, data)
            side.send(len(data), callback)

    def _declare_token(self, key: str) -> SimpleNamespace:
        self.tokens.append(key)
        for side in list(self.sides):
            side.tell_token(key, zenoh.SampleKind.PUT)
        return SimpleNamespace(undeclare=lambda: self._undeclare_token(key))

    def _undeclare_token(self, key: str) -> None:
        self.tokens.remove(key)
        for side in list(self.sides):
            side.tell_token(key, zenoh.SampleKind.DELETE)

    def _watch(
        self, key: str, callback: Callable[[Any], object], *, history: bool = False
    ) -> _Declared:
        declared = _Declared(self._watchers, key, callback)
        known = [t for s in self.sides for t in s.known if matches(key, t)]
        for token in known if history else ():
            sample = _sample(token, zenoh.SampleKind.PUT)
            self.process.spawn("zenoh", partial(callback, sample))
        return declared


class _Declared:
    """A declaration, until it is undone."""

    def __init__(
        self, among: list[_Declared], key: str, callback: Callable[[Any], object]
    ) -> None:
        self.key = key
        self.callback = callback
        self._among = among
        among.append(self)

    def undeclare(self) -> None:
        """Undo it."""
        if self in self._among:
            self._among.remove(self)


@lru_cache(maxsize=1024)
def matches(pattern: str, key: str) -> bool:
    """Return whether a key is among those of a pattern with `*`, or `**` at its end."""
    if pattern == key:
        return True
    wanted, words = pattern.split("/"), key.split("/")
    if wanted[-1] == "**":
        return words[: len(wanted) - 1] == wanted[:-1]
    return len(wanted) == len(words) and all(
        w in {"*", f} for w, f in zip(wanted, words, strict=True)
    )


def _sample(key: str, kind: zenoh.SampleKind, data: bytes = b"") -> SimpleNamespace:
    return SimpleNamespace(key_expr=key, kind=kind, payload=_payload(data))


def _payload(data: bytes) -> SimpleNamespace:
    return SimpleNamespace(to_bytes=lambda: data)


_BEATS = 4
"""So often in a timeout each side says that it is there."""
_SMALL = 20
MOST_WAITING = 2000
"""What a process does not take is dropped beyond this."""


class SimulatedConnection:
    """Two sessions that hear each other.

    `on_lost`: called when it has ended, for the one that connected.
    """

    def __init__(
        self,
        network: Network,
        client: Session,
        server: Session,
        on_lost: Callable[[], object],
    ) -> None:
        self.scheduler = network.scheduler
        self.network = network
        self._on_lost = on_lost
        self.sides = Side(self, client), Side(self, server)
        for side, other in zip(self.sides, reversed(self.sides), strict=True):
            side.begin(other)

    def close(self, by: Side, *, is_told: bool) -> None:
        """End it on one side; the other learns it, over a cut by its timeout."""
        if by.is_closed:
            return
        other = by.other
        by.lose()
        if is_told:
            by.stream.send(_SMALL, lambda: self.close(other, is_told=False))
        else:
            by.stream.close()
        if by is self.sides[0] and not by.session.is_closed:
            self._on_lost()


class Side:
    """One side of a connection.

    `known`: the other side's tokens.
    """

    other: Side

    def __init__(self, connection: SimulatedConnection, session: Session) -> None:
        self.connection = connection
        self.session = session
        self.known: list[str] = []
        self.is_closed = False
        self._heard_at = connection.scheduler.now
        self._received: deque[Callable[[], object]] = deque()
        self._is_taking = False
        self._asked: dict[int, Any] = {}

    def begin(self, other: Side) -> None:
        """Say which tokens there are, and go on to say that it is there."""
        self.other = other
        here, there = (s.session.process.computer.name for s in (self, other))
        self.stream = self.connection.network.engine.stream(here, there)
        self.session.sides.append(self)
        for token in self.session.tokens:
            self.tell_token(token, zenoh.SampleKind.PUT)
        self._beat()

    def send(self, size: int, act: Callable[[], object]) -> None:
        """Let the other side's process do something, after all that was sent before."""
        self.stream.send(size, lambda: self.other.receive(act))

    def receive(self, act: Callable[[], object]) -> None:
        """Do what was sent, on a task of this process; for the simulated world."""
        self._heard_at = self.connection.scheduler.now
        if self.is_closed or len(self._received) >= MOST_WAITING:
            return
        self._post(act)

    def tell_token(self, key: str, kind: zenoh.SampleKind) -> None:
        """Say that a token came or went."""
        self.send(_SMALL, lambda: self.other.note_token(key, kind))

    def note_token(self, key: str, kind: zenoh.SampleKind) -> None:
        """Note that a token of the other side came or went."""
        is_known = key in self.known
        if (kind == zenoh.SampleKind.PUT) == is_known:
            return
        (self.known.remove if is_known else self.known.append)(key)
        self.session.note_token(key, kind)

    def ask(self, key: str, handler: Any, payload: bytes, timeout: float) -> None:  # noqa: ANN401, zenoh's
        """Ask the other side; the handler gets its replies, and is then dropped."""
        scheduler, other = self.connection.scheduler, self.other
        number = scheduler.number()
        self._asked[number] = handler

        def reply(_: object, data: bytes) -> None:
            said = SimpleNamespace(ok=SimpleNamespace(payload=_payload(data)))
            other.send(len(data), lambda: self._replied(number, said))

        def drop() -> None:
            other.send(_SMALL, lambda: self._end_asked(number))

        query = SimpleNamespace(
            key_expr=key, payload=_payload(payload), reply=reply, drop=drop
        )

        def hear() -> None:
            callback = other.session.queryable(key)
            if callback is None:
                drop()
            else:
                callback(query)

        self.send(len(payload), hear)
        until = scheduler.now + timeout
        scheduler.at(until, lambda: self._post(lambda: self._end_asked(number)))

    def lose(self) -> None:
        """Be without the other side: its tokens are gone, what was asked is dropped."""
        self.is_closed = True
        self._received.clear()
        if self in self.session.sides:
            self.session.sides.remove(self)
        for key in list(self.known):
            self._post(partial(self.note_token, key, zenoh.SampleKind.DELETE))
        for number in list(self._asked):
            self._post(partial(self._end_asked, number))

    def _replied(self, number: int, said: SimpleNamespace) -> None:
        if number in self._asked:
            self._asked[number].callback(said)

    def _end_asked(self, number: int) -> None:
        handler = self._asked.pop(number, None)
        if handler is not None:
            handler.drop()

    def _beat(self) -> None:
        """Say that this side is there; give up the other one when it is silent."""
        scheduler, process = self.connection.scheduler, self.session.process
        if self.is_closed or process.is_dead:
            return
        timeout = self.session.timeout
        if not process.is_paused:
            if scheduler.now - self._heard_at > self.other.session.timeout:
                self.connection.close(self, is_told=True)
                return
            if not self.stream.is_cut:
                self.stream.send(_SMALL, self.other.note_beat)
        pause = self.connection.network.choices.between("network", 0.9, 1.0)
        scheduler.at(scheduler.now + pause * timeout / _BEATS, self._beat)

    def note_beat(self) -> None:
        """Note that the other side is there; for the simulated world."""
        self._heard_at = self.connection.scheduler.now

    def _post(self, act: Callable[[], object]) -> None:
        if self.session.process.is_dead:
            return
        self._received.append(act)
        if not self._is_taking:
            self._is_taking = True
            self.session.process.spawn("zenoh", self._run_received)

    def _run_received(self) -> None:
        try:
            while self._received:
                self._received.popleft()()
        finally:
            self._is_taking = False
