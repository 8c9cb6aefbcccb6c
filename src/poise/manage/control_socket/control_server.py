"""The manager's control socket: accepts commands on threads of its own.

A record comes in on each connection, which waits on its own thread for the result. A
client that disconnects cancels its command, unless that has begun.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, wait
from pathlib import Path
from typing import Self

from poise import threads
from poise.clock import time_of_day, wall_time
from poise.errors import RunError, UsageError
from poise.manage.control_socket.commands import (
    Command,
    RecordCommand,
    Refusal,
    Result,
    StatusCommand,
    StopCommand,
)
from poise.wire import frame
from poise.wire.codec import Unreadable, WireError
from poise.wire.robots_here import former_of, is_alive, make_folder, path_of

log = logging.getLogger(__name__)
Submit = Callable[[Command], "Future[Result | Refusal]"]
"""Takes a command, from any thread, at once; its future may be cancelled."""

MOST_CLIENTS = 256
"""At most this many clients are served at a time; further ones wait to connect."""
MOST_OTHERS = 224
"""So many of them have commands that may take long, such as calls; more are refused:
who waits for one asks for a status meanwhile, and takes the manager for dead without.
"""
_LOOK_EVERY = 0.1
_START_PATIENCE = 1.0
"""A status waits for so long [s] for a robot that starts, or for the next leader."""
_CLOSE_LIMIT = 2.0
"""Clients that have their result take it within this time at the end [s]."""


class ControlServer:
    """The control socket of a robot. Use it as a context manager.

    `takes_over`: in place of another manager's, which is there again if this one closes
    before it has started.
    """

    def __init__(self, robot: str, *, takes_over: bool = False) -> None:
        self._robot = robot
        self._path = path_of(robot)
        self._former = former_of(self._path)
        self._is_closed = threading.Event()
        self._free = threading.Semaphore(MOST_CLIENTS)
        self._others = threading.Semaphore(MOST_OTHERS)
        self._threads: set[threading.Thread] = set()
        self._acceptor = threads.daemon(self._accept, "control", again=True)
        self._since = wall_time()
        self._submit: Submit | None = None
        self._is_up = threading.Event()
        try:
            self._make_folder(takes_over=takes_over)
            self._listener = _listening(self._path)
            self._inode = self._path.stat().st_ino
        except OSError as error:
            raise RunError(
                f"cannot listen on {self._path} ({error}): set XDG_RUNTIME_DIR to a "
                "folder that you own, with a short path"
            ) from error

    def __enter__(self) -> Self:
        self._acceptor.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self, submit: Submit) -> None:
        """Carry out commands from now on; all but statuses have waited for that."""
        self._submit = submit
        self._is_up.set()
        self._former.unlink(missing_ok=True)

    def close(self) -> None:
        """Serve no more clients, and let those that have their result take it."""
        try:
            if self._path.stat().st_ino == self._inode:  # else it is a successor's
                self._path.unlink()
                if not is_alive(self._path):
                    self._former.unlink(missing_ok=True)
        except FileNotFoundError:
            pass
        except OSError as error:  # the next manager replaces it
            log.warning("the socket of this manager stays: %s", error)
        self._is_closed.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # which wakes `accept`
        if self._acceptor.is_alive():
            self._acceptor.join(_CLOSE_LIMIT)
        for thread in list(self._threads):
            thread.join(_CLOSE_LIMIT)
        self._listener.close()

    def _make_folder(self, *, takes_over: bool) -> None:
        folder = make_folder()
        if is_alive(self._path) and not takes_over:
            raise UsageError(
                f"robot '{self._robot}' runs already; `poise stop` ends it, and "
                "`poise up --take-over` becomes its manager"
            )
        for left in folder.glob("*.sock"):  # by managers that were killed
            if not is_alive(left):
                left.unlink(missing_ok=True)
        self._former.unlink(missing_ok=True)
        with contextlib.suppress(FileNotFoundError):
            self._former.hardlink_to(self._path)

    def _accept(self) -> None:
        while not self._is_closed.is_set():
            self._free.acquire()
            try:
                connection, _ = self._listener.accept()
                threads.daemon(self._serve, "client", connection).start()
            except (OSError, RuntimeError) as error:  # no descriptor or thread is free
                self._free.release()
                if self._is_closed.wait(_LOOK_EVERY):
                    return
                log.warning("robot '%s' cannot serve a client: %s", self._robot, error)

    def _serve(self, connection: socket.socket) -> None:
        self._threads.add(threading.current_thread())
        try:
            with connection, contextlib.suppress(WireError, RunError):
                result = self._respond(connection)
                if result is not None:
                    frame.send_record(connection, result)
        finally:
            self._threads.discard(threading.current_thread())
            self._free.release()

    def _respond(self, connection: socket.socket) -> Result | Refusal | None:
        """Return the result of the command that comes in, or why it is none."""
        try:
            command: Command = frame.receive_record(connection, Command)
        except Unreadable:
            raise
        except WireError as error:
            why = error.__cause__ or error
            return Refusal(f"robot '{self._robot}' knows no such command: {why}")
        if isinstance(command, RecordCommand | StopCommand):
            return self._result_when_up(connection, command)
        if not self._others.acquire(blocking=False):
            text = f"robot '{self._robot}' has {MOST_OTHERS} commands under way"
            return Refusal(f"{text}: ask again when some are done", "RunError")
        try:
            return self._result_when_up(connection, command)
        finally:
            self._others.release()

    def _result_when_up(
        self, connection: socket.socket, command: Command
    ) -> Result | Refusal | None:
        """Return the result once it is there; None when the client has left."""
        is_status = isinstance(command, StatusCommand)
        if is_status and not self._is_up.wait(_START_PATIENCE):
            since = time_of_day(self._since)
            text = f"robot '{self._robot}' has been starting since {since}"
            return Refusal(text, "RunError")
        while not self._is_up.wait(_LOOK_EVERY) and not _has_left(connection):
            if self._is_closed.is_set():
                return Refusal(f"robot '{self._robot}' did not start", "RunError")
        if self._submit is None or _has_left(connection):
            return None  # it gave up while this process was stopped, say
        return self._await_result(connection, self._submit(command))

    def _await_result(
        self, connection: socket.socket, future: Future[Result | Refusal]
    ) -> Result | Refusal | None:
        while not wait([future], _LOOK_EVERY).done:
            if _has_left(connection):
                future.cancel()
                return None
            if self._is_closed.is_set() and future.cancel():
                return Refusal(f"robot '{self._robot}' has stopped", "RunError")
        try:
            return future.result()
        except CancelledError:
            return None


def _listening(path: Path) -> socket.socket:
    """Return a socket that listens, and is at `path` only since it does."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        draft = path.with_suffix(f".{os.getpid()}")
        listener.bind(os.fspath(draft))
        listener.listen(MOST_CLIENTS)
        draft.rename(path)
    except OSError:
        listener.close()
        raise
    return listener


def _has_left(connection: socket.socket) -> bool:
    try:
        return not connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False
    except OSError:
        return True
