"""The sending end of a connector: connections to the container where it ends.

A call has a connection to itself until its answer is there. The calling thread reads
that, so no thread wakes another. Messages use one connection, which keeps their order,
and on which credit comes back. A receiver takes all that came over it before what comes
over the one that replaces it.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from poise.errors import CallError, Timeout, Unavailable
from poise.wire.address import Address
from poise.wire.connections.connection import LAST_ANSWER, Connection
from poise.wire.connections.opening import CALLS, MESSAGES, NOT_HERE, Opening
from poise.wire.frame import Frame, Pieces


class Closed(Unavailable):
    """The channel was closed here before anything was sent."""


_PAUSE = 0.05
"""After a refusal it is not tried for this time, and a message that waits notices so
often that the other computer is taken for lost [s]."""
_SPARE = 8
"""Connections kept open per connector when no call uses them."""
_IDLE = 30.0
"""Connections unused for this time are closed, with their shared memory [s]."""


class _Connections:
    """Open connections for one use; idle ones are closed."""

    def __init__(self) -> None:
        self._open: set[Connection] = set()
        self._recent: list[Connection] = []
        self._older: list[Connection] = []
        self._is_closed = False

    def __iter__(self) -> Iterator[Connection]:
        """Yield the idle ones."""
        return iter([*self._recent, *self._older])

    def is_alive(self) -> bool:
        """Return at once whether one reaches the other end, as far as is known."""
        idle = {*self}
        return any(
            connection not in idle or connection.is_idle()
            for connection in list(self._open)
        )

    def is_in_use(self) -> bool:
        """Return at once whether one is not idle."""
        return not self._open <= {*self}

    def pop(self) -> Connection | None:
        """Return the idle one that was used last."""
        try:
            return self._recent.pop() if self._recent else self._older.pop()
        except IndexError:  # also when another thread was quicker
            return None

    def add(self, connection: Connection) -> None:
        """Add one that is in use."""
        self._open.add(connection)

    def put(self, connection: Connection) -> None:
        """Keep one that is idle now, or close it."""
        if len(self._recent) >= _SPARE:
            self.drop(connection)
            return
        self._recent.append(connection)
        if self._is_closed:  # perhaps just now
            self.close()

    def drop(self, connection: Connection) -> None:
        """Close one that was in use."""
        self._open.discard(connection)
        connection.close()

    def end(self) -> None:
        """Let their users find all closed; from any thread."""
        for connection in list(self._open):
            connection.end()

    def close_older(self) -> None:
        """Close those that were idle since the last time, except one without memory."""
        with contextlib.suppress(IndexError):  # others may take some meanwhile
            if not self._recent and not self._older[-1].has_blocks:
                self._recent.append(self._older.pop())
        self._drop_all(self._older)
        self._older, self._recent = self._recent, []

    def close_idle(self) -> None:
        """Close those that are idle."""
        self._drop_all(self._recent)
        self._drop_all(self._older)

    def close(self) -> None:
        """Close all, also those that are given back later."""
        self._is_closed = True
        self.close_idle()

    def _drop_all(self, connections: list[Connection]) -> None:
        with contextlib.suppress(IndexError):  # others may take some meanwhile
            while True:
                self.drop(connections.pop())


class Channel:
    """The sending end; connects when first used, and again when the peer came back."""

    def __init__(
        self,
        connector: str,
        address: Address,
        folder: Path,
        use: int = CALLS,
        on_frame: Callable[[Frame], bool] | None = None,
        first: Callable[[], Pieces] | None = None,
    ) -> None:
        self._connector = connector
        self._address = address
        self._folder = folder
        self._use = use
        self._on_frame = on_frame
        self._first = first
        self._calls, self._messages = self._connections = _Connections(), _Connections()
        self._openings: dict[int, Opening] = {}
        self._is_closed = False
        self._is_lost = self._is_given_up = False
        self._refusal = ""
        self._ordering = threading.Lock()
        self._looked_at = time.monotonic()
        self._ask_at = 0.0

    def try_connect(self) -> bool:
        """Connect if needed, and return at once whether the receiving end is there."""
        now = time.monotonic()
        if now - self._looked_at > _IDLE:
            self._looked_at = now
            for connections in self._connections:
                connections.close_older()
        return (
            any(connections.is_alive() for connections in self._connections)
            or self._is_reached()
        )

    @property
    def refusal(self) -> str:
        """Why another computer was not reached last, if it is known; empty: it was."""
        here = self._address.gateway is None or self._refusal == NOT_HERE
        return "" if here else self._refusal

    def is_calling(self) -> bool:
        """Return at once whether a call waits for its answer."""
        return self._calls.is_in_use()

    def request(self, pieces: Pieces, limit: float) -> Frame:
        """Send a call and return its answer; Timeout after `limit` [s]."""
        if self._is_closed:
            raise Closed(f"{self._connector} is closed")
        deadline = time.monotonic() + limit
        connections = self._calls
        while True:
            idle = self._fresh(connections)
            connection = idle or self._connect(CALLS, deadline)
            try:
                answer = connection.ask(pieces, deadline)
            except BaseException:
                # also when a signal's handler raises: the answer may still come, and
                # the next call must not read it
                connections.drop(connection)
                raise
            if answer is not None and answer.number != LAST_ANSWER:
                connections.put(connection)
                return answer
            connections.drop(connection)
            if answer is not None:
                return answer
            if idle is None:  # else the receiver had closed it while it was idle
                raise Unavailable(f"{self._connector}: {self._address} went away")

    def push(
        self, pieces: Pieces, limit: float, on_sent: Callable[[], object] = lambda: None
    ) -> None:
        """Send a message in order, within `limit` [s]; then call `on_sent`."""
        deadline = time.monotonic() + limit
        if not self._ordering.acquire(timeout=limit):
            raise Timeout(
                f"{self._connector}: other threads have been sending for {limit:g} s"
            )
        try:
            self._messages.put(self._send(pieces, deadline))
            on_sent()
        finally:
            self._ordering.release()

    def give_up(self) -> None:
        """Take the other computer for lost: messages do not wait for it any more."""
        self._is_lost = self._is_given_up = self._address.gateway is not None
        self._messages.end()

    def close(self) -> None:
        """Send no more; connections in use are closed when their call is over."""
        self._is_closed = True
        self._messages.close()
        self._calls.close()
        with contextlib.suppress(KeyError):  # others may take some meanwhile
            while True:
                self._openings.popitem()[1].close()

    def _send(self, pieces: Pieces, deadline: float) -> Connection:
        """Send a message over the open connection or a new one; return that."""
        connections = self._messages
        while True:
            idle = self._fresh(connections)
            connection = idle or self._connect(MESSAGES, deadline)
            try:
                connection.send(pieces, deadline)
            except Unavailable:
                connections.drop(connection)
                if idle is None or self._is_lost:
                    raise
                # the receiver closed it while it was idle, and has got nothing
            except BaseException:
                # also when a signal's handler raises: part of it may have been sent
                connections.drop(connection)
                raise
            else:
                return connection

    def _fresh(self, connections: _Connections) -> Connection | None:
        """Return an open connection that, as far as is known, reaches the other end."""
        while (connection := connections.pop()) and (
            connection.is_over or not (connection.is_local or connection.is_idle())
        ):
            self._is_lost |= connection.is_lost
            connections.drop(connection)
        return connection

    def _connect(self, use: int, deadline: float) -> Connection:
        """Return a new connection; a message waits for a silent computer only once."""
        self._is_given_up = False
        until = deadline if use == CALLS or not self._is_lost else 0.0
        while True:
            look_at = time.monotonic() + _PAUSE if use == MESSAGES else until
            connection = self._opened(use, min(until, look_at))
            if connection is not None:
                return connection
            has_ended = self._is_given_up or self._is_closed
            if has_ended or time.monotonic() >= until:
                break
        self._is_lost = self._address.gateway is not None
        raise Unavailable(f"{self._connector}: no answer from {self._address}")

    def _is_reached(self) -> bool:
        """Open a connection as far as that needs no wait; whether it is open."""
        # two connections for messages would not keep their order
        if time.monotonic() < self._ask_at or not self._ordering.acquire(
            blocking=False
        ):
            return False
        try:
            # nor would one beside another that may come back after a cut
            for connections in self._connections:
                connections.close_idle()
            connection = self._opened(self._use, 0.0)
            if connection is not None:
                self._connections[self._use].put(connection)
        except CallError:
            self._ask_at = time.monotonic() + _PAUSE
            return False
        finally:
            self._ordering.release()
        return connection is not None

    def _opened(self, use: int, deadline: float) -> Connection | None:
        """Return a new connection that is open before `deadline`, or None."""
        try:
            # taken out of the table, it belongs to this thread alone
            opening = self._openings.pop(use, None) or Opening(
                self._connector, self._address, self._folder
            )
            is_open = opening.go_on(use, deadline)
        except CallError as error:
            self._refusal = str(error).removeprefix(f"{self._connector}: ")
            raise
        if is_open:
            self._is_lost, self._refusal = False, ""
            connection = opening.connection
            if use == MESSAGES:
                self._begin(connection, deadline)
            self._connections[use].add(connection)
            return connection
        if opening.is_late() or self._is_closed:
            self._is_lost = self._address.gateway is not None
            opening.close()
        else:
            self._openings[use] = opening
        return None

    def _begin(self, connection: Connection, deadline: float) -> None:
        try:
            if self._on_frame:
                connection.follow(self._on_frame)
            if self._first:
                connection.send(self._first(), deadline)
        except BaseException:  # nobody else knows the connection yet
            connection.close()
            raise
