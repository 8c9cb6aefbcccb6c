"""A container's connection to its agent, made again after the agent was killed.

It works on, asks the next agent to adopt it at a socket in the folder of both, handing
over a new connection and its stats page, and ends after `ORPHAN_LIMIT`.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from pathlib import Path
from typing import Any

from msgspec import Struct

from poise.clock import Clock
from poise.errors import Unavailable
from poise.waker import is_writable
from poise.wire import frame
from poise.wire.address import agent_path, keep_private
from poise.wire.records.request_records import Versioned
from poise.wire.records.status_records import FromContainer, ToContainer

ORPHAN_LIMIT = 60.0
"""A container that has had no agent for this time ends [s]."""
_PASSED = 2
"""Descriptors that are handed over: a control socket and a stats page."""
_PAUSE = 0.2
"""It asks an agent to adopt it this often [s]."""
_INBOX = 1 << 16


class Orphan(Versioned, frozen=True, kw_only=True):
    """A container without an agent asks to be adopted."""

    container: str
    pid: int


class AgentLink:
    """The connection of one container to its agent; none while that is gone."""

    def __init__(
        self,
        container: str,
        connection: socket.socket,
        stats_page: int,
        folder: Path,
        clock: Clock,
    ) -> None:
        self._container = container
        self._connection: socket.socket | None = connection
        self._reader = frame.RecordReader(connection)
        self._writer = frame.RecordWriter(connection)
        keep_private(connection)
        self._stats_page = stats_page
        self._path = os.fspath(agent_path(folder))
        self._clock = clock
        self._telling = threading.Lock()
        self._lost_at = float("inf")
        self._ask_at = 0.0

    def files(self) -> list[int]:
        """Return the descriptor to wait for, if there is one now."""
        return [] if self._connection is None else [self._connection.fileno()]

    @property
    def due(self) -> float:
        """When `ask_when_due` is to be called next [s]."""
        return float("inf") if self._connection else self._ask_at

    def ask_when_due(self) -> None:
        """Ask to be adopted when there is no agent, and it is time."""
        now = self._clock.now()
        if self._connection is not None or now < self._ask_at:
            return
        if now - self._lost_at > ORPHAN_LIMIT:
            raise Unavailable(f"there was no agent for {ORPHAN_LIMIT:g} s")
        self._ask_at = now + _PAUSE
        self._ask()

    def receive(self) -> ToContainer | None:
        """Return what the agent tells; None: not all is there, or it is gone."""
        if self._connection is None:
            return None
        try:
            record: ToContainer | None = self._reader.next(ToContainer)
        except Unavailable:
            self._lose()
            return None
        return record

    def send(self, record: FromContainer) -> None:
        """Tell the agent, if there is one; raises as `RecordWriter.send`."""
        # `receive` finds out that it is gone, on the control thread
        with self._telling, contextlib.suppress(Unavailable):
            if self._connection is not None:
                self._writer.send(record)

    def has_room(self) -> bool:
        """Return at once whether the agent would take another record."""
        return self._connection is not None and is_writable(self.files()[0])

    def _lose(self) -> None:
        now = self._clock.now()
        with self._telling:
            if self._connection is not None:
                self._connection.close()
            self._connection = None
        self._lost_at = self._ask_at = now

    def _ask(self) -> None:
        orphan = Orphan(container=self._container, pid=os.getpid())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
                asking.setblocking(False)
                asking.connect(self._path)
                ours = hand_over(asking, orphan, self._stats_page)
        except OSError:  # no agent is there yet, or no descriptor is free
            return
        keep_private(ours)
        self._reader = frame.RecordReader(ours)
        with self._telling:
            self._connection, self._writer = ours, frame.RecordWriter(ours)


def is_adopting(folder: Path) -> bool:
    """Return whether an agent that works in this folder adopts containers."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        return asking.connect_ex(os.fspath(agent_path(folder))) == 0


def hand_over(way: socket.socket, record: Struct, stats_page: int) -> socket.socket:
    """Send a record, an end of a new control socket and a stats page; return ours."""
    ours, theirs = socket.socketpair()
    with theirs:
        try:
            files = [theirs.fileno(), stats_page]
            socket.send_fds(way, [frame.pack_record(record)], files)
        except OSError:
            ours.close()
            raise
    return ours


def take_over(
    way: socket.socket,
    type_: Any,  # noqa: ANN401, a record's
) -> tuple[Any, socket.socket | None, int]:
    """Return what `hand_over` has sent; None and -1: no descriptor was free."""
    body, files, _, _ = socket.recv_fds(way, _INBOX, _PASSED)
    with contextlib.ExitStack() as unused:
        for file in files:
            unused.callback(os.close, file)
        if not body:
            raise ConnectionResetError("the other end is gone")
        record = frame.unpack_record(body, type_)
        if len(files) < _PASSED:
            return record, None, -1
        connection = socket.socket(fileno=files[0])
        unused.pop_all()
    return record, connection, files[1]
