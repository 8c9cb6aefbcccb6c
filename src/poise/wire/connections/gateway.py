"""The gateway of a computer: where connections from other computers arrive.

It hands each on to the container that the first frame names: a restarted container
keeps its address.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
import time
from pathlib import Path
from typing import Self

from poise import threads
from poise.endpoint import Endpoint
from poise.errors import CallError, RunError, Sparing
from poise.wire import frame
from poise.wire.address import connect, family_of, gateway_path, tune
from poise.wire.codec import WireError
from poise.wire.connections.connection import Connection
from poise.wire.connections.opening import ANSWER_LIMIT, NAME, AcceptWarning
from poise.wire.frame import FrameKind

log = logging.getLogger(__name__)

SAY_LIMIT = 1.0
"""A new connection names its container within this time [s]."""
MOST = 64
"""Connections that are read at a time."""
_LARGEST = 1024
"""A larger first frame is refused [bytes]."""
_BACKLOG = 128
_PAUSE = 0.01


class Gateway:
    """Listens for connections from other computers, a thread for each."""

    def __init__(self, folder: Path, host: str, port: int = 0) -> None:
        self._folder = folder
        self._closed = threading.Event()
        self._room = threading.Semaphore(MOST)
        self._sparing = Sparing(log)
        self.warning = AcceptWarning("the gateway")
        try:
            self._listener = socket.create_server(
                (host, port), family=family_of(host), backlog=_BACKLOG
            )
        except OSError as error:
            why = str(error.strerror or error).partition(" (while")[0]  # once is enough
            raise RunError(f"cannot listen on {Endpoint(host, port)}: {why}") from None
        self._address = str(Endpoint(*self._listener.getsockname()[:2]))
        tune(self._listener)
        self._thread = threads.daemon(self._main, "gateway")
        self._thread.start()

    def __str__(self) -> str:
        """Return its IP address and port."""
        return self._address

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Accept no more; connections that were handed on stay."""
        self._closed.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join()

    def _main(self) -> None:
        with self._listener:
            threads.keep_at(self._accept_all)

    def _accept_all(self) -> None:
        while not self._closed.is_set():
            self._room.acquire()
            try:
                self._accept()
            except Exception as error:
                self._room.release()
                if not isinstance(error, OSError):
                    raise
                if not self._closed.is_set():
                    self.warning.note(error)
                    self._closed.wait(_PAUSE)

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        attending = threads.daemon(self._attend, "arrival", connection)
        try:
            attending.start()
        except RuntimeError as error:  # other threads may end
            connection.close()
            raise OSError(str(error)) from error

    def _attend(self, connection: socket.socket) -> None:
        """Hand a connection on to the container that it names, or say why not."""
        try:
            with connection, contextlib.suppress(CallError, OSError):
                try:
                    why = self._hand_on(connection, _named(connection))
                except WireError as error:
                    why = str(error)
                    text = "a connection from %s is refused: %s"
                    peer = connection.getpeername()[0]
                    self._sparing.warn("refused", text, peer, why)
                if why:
                    _refuse(connection, why)
        finally:
            self._room.release()

    def _hand_on(self, connection: socket.socket, container: str) -> str:
        """Return why the container does not get a connection; empty: it does."""
        path = gateway_path(self._folder, container)
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as handing_on:
                connect(handing_on, path, ANSWER_LIMIT)
                socket.send_fds(handing_on, [b"+"], [connection.fileno()])
        except (FileNotFoundError, ConnectionRefusedError):
            # usual while a robot starts: the sender tries again
            return f"no container '{container}' is here"
        except BlockingIOError:
            limit = f"{ANSWER_LIMIT:g} s"
            return f"container '{container}' accepted no connection within {limit}"
        except OSError as error:
            return f"container '{container}' accepts no connection: {error}"
        return ""


def _named(connection: socket.socket) -> str:
    """Return the container that a connection names, and read nothing behind it."""
    deadline = time.monotonic() + SAY_LIMIT
    hello = frame.parse(frame.receive_packet(connection, deadline, _LARGEST))
    if hello.kind is not FrameKind.HELLO:
        raise WireError(f"a frame of the kind {hello.kind.name}, not a name")
    name: str = hello.value(NAME)
    return name


def _refuse(connection: socket.socket, why: str) -> None:
    """Send why; then wait for the other end to close."""
    deadline = time.monotonic() + SAY_LIMIT
    Connection(connection).send(frame.segments(NAME, why, FrameKind.ERROR), deadline)
    connection.shutdown(socket.SHUT_WR)
    connection.settimeout(SAY_LIMIT)
    while time.monotonic() < deadline and connection.recv(_LARGEST):
        pass  # unread bytes would reset the answer
