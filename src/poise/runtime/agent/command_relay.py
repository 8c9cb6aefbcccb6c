"""Passes commands of other computers to the manager, where it runs beside the agent.

A manager takes them on its own computer only; agents ask who sends for a certificate.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path

import zenoh

from poise import threads
from poise.errors import RunError
from poise.waker import wait_readable
from poise.wire import frame
from poise.wire.address import connect
from poise.wire.codec import WireError
from poise.wire.control_session import COMMAND_LIMIT
from poise.wire.records.request_records import ManagerId
from poise.wire.robots_here import peer_of

HERE = b"here"
"""The answer to an empty command, where the manager runs."""
_MOST = 16
"""So many commands are under way at a time; more are refused."""


class CommandRelay:
    """Answers queries with what the manager says; empty: it does not run here."""

    def __init__(self, key: str, manager: Callable[[], ManagerId | None]) -> None:
        self._key = key
        self._manager = manager
        self._free = threading.Semaphore(_MOST)

    def hear(self, query: zenoh.Query) -> None:
        """Answer a query soon; for zenoh's threads."""
        if not self._free.acquire(blocking=False):
            _refuse(query, f"over {_MOST} commands are under way")
            return
        try:
            threads.daemon(self._answer, "command", query).start()
        except RuntimeError as error:  # other threads may end
            self._free.release()
            _refuse(query, f"its agent cannot pass it on for now: {error}")

    def _answer(self, query: zenoh.Query) -> None:
        command = query.payload.to_bytes() if query.payload is not None else b""
        try:
            query.reply(self._key, self._response(command))
        except (OSError, RunError, WireError) as error:
            _refuse(query, f"the manager gave no answer: {error}")
        finally:
            query.drop()  # type: ignore[no-untyped-call]
            self._free.release()

    def _response(self, command: bytes) -> bytes:
        manager = self._manager()
        if manager is None or not manager.control or not Path(manager.control).exists():
            return b""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            try:
                connect(connection, Path(manager.control), frame.RECORD_LIMIT)
            except ConnectionError:  # nobody listens there any more
                return b""
            if peer_of(connection) != manager.pid:
                return b""
            if not command:
                return HERE
            frame.send_packet(connection, command)
            if not wait_readable([connection.fileno()], COMMAND_LIMIT):
                raise RunError(f"it has been busy for {COMMAND_LIMIT:g} s")
            return frame.receive_packet(connection)


def _refuse(query: zenoh.Query, why: str) -> None:
    query.reply_err(why.encode())
