"""A connection of two sessions, as each side sees it.

The end of a process is seen at once: its kernel says so. A frozen process, or a cut, is
seen only by the silence, after the lease.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import zenoh

from poise.simulation.network.network import Network

if TYPE_CHECKING:
    from poise.simulation.network.zenoh_sessions import Session

_BEATS = 4
"""So often in a lease each side says that it is there."""
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
        """End it on one side; the other learns it, over a cut by its lease."""
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
        self.stream = self.connection.network.stream(here, there)
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
        self.send(_SMALL, lambda: self.other.take_token(key, kind))

    def take_token(self, key: str, kind: zenoh.SampleKind) -> None:
        """Note that a token of the other side came or went."""
        is_known = key in self.known
        if (kind == zenoh.SampleKind.PUT) == is_known:
            return
        (self.known.remove if is_known else self.known.append)(key)
        self.session.take_token(key, kind)

    def ask(self, key: str, handler: Any, payload: bytes, timeout: float) -> None:  # noqa: ANN401, zenoh's
        """Ask the other side; the handler gets its replies, and is then dropped."""
        scheduler, other = self.connection.scheduler, self.other
        number = scheduler.number()
        self._asked[number] = handler

        def reply(_: object, data: bytes) -> None:
            ok = SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: data))
            said = SimpleNamespace(ok=ok)
            other.send(len(data), lambda: self._replied(number, said))

        def drop() -> None:
            other.send(_SMALL, lambda: self._end_asked(number))

        query = SimpleNamespace(
            key_expr=key,
            payload=SimpleNamespace(to_bytes=lambda: payload),
            reply=reply,
            drop=drop,
        )

        def hear() -> None:
            take = other.session.queryable(key)
            if take is None:
                drop()
            else:
                take(query)

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
            self._post(partial(self.take_token, key, zenoh.SampleKind.DELETE))
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
        lease = self.session.lease
        if not process.is_paused:
            if scheduler.now - self._heard_at > self.other.session.lease:
                self.connection.close(self, is_told=True)
                return
            if not self.stream.is_cut:
                self.stream.send(_SMALL, self.other.note_beat)
        pause = self.connection.network.choices.between("network", 0.9, 1.0)
        scheduler.at(scheduler.now + pause * lease / _BEATS, self._beat)

    def note_beat(self) -> None:
        """Note that the other side is there; for the simulated world."""
        self._heard_at = self.connection.scheduler.now

    def _post(self, act: Callable[[], object]) -> None:
        if self.session.process.is_dead:
            return
        self._received.append(act)
        if not self._is_taking:
            self._is_taking = True
            self.session.process.spawn("zenoh", self._take)

    def _take(self) -> None:
        try:
            while self._received:
                self._received.popleft()()
        finally:
            self._is_taking = False
