"""The receiving end of a container: a thread for each connection from others."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import select
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct

from poise import threads
from poise.errors import Sparing, Timeout, Unavailable
from poise.wire import frame
from poise.wire.address import gateway_path, keep_private, socket_path
from poise.wire.codec import Unreadable, WireError
from poise.wire.connections import connection
from poise.wire.connections.connection import LAST_ANSWER, Connection
from poise.wire.connections.opening import (
    ANSWER_LIMIT,
    MESSAGES,
    NAME,
    NOT_HERE,
    AcceptWarning,
    own_keys,
)
from poise.wire.frame import Frame, FrameKind, Pieces

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials

log = logging.getLogger(__name__)

Handler = Callable[[Frame], Pieces | None]
"""Takes a frame and returns the pieces of an answer, or None.

It may block, and must not raise. Messages of one channel come one after the other, in
order.
"""
Refused = Callable[[], object]
"""Is told of a malformed frame; must not block or raise."""

LAST_LIMIT = 0.5
"""When it closes, calls under way have this time to be answered [s]."""
_TAKE_LIMIT = 30.0
"""A caller that does not read its answer within this time is given up [s]: a state of
300 MB takes so long over 100 Mbit/s."""
_PAUSE = 0.01
_PATIENCE = 1.0
"""Once its sender left a connection, this silence ends it: the sender was lost [s]."""
_RESENDING = 5.0
"""The same where the new connection comes from the same computer, which is not lost:
TCP doubles its pause at each retransmission, and may resume late after a cut [s]."""
_MOST_CONNECTIONS = 256
"""Connections that a container serves at a time; others are closed at once."""


class _ServedConnection(Struct, eq=False):
    """A connection, its thread, its connector and its use."""

    connection: Connection
    thread: threading.Thread
    connector: str = "unknown"
    use: int = 0


class ConnectionServer:
    """Serves the connections that end in a container."""

    def __init__(self, folder: Path, container: str) -> None:
        self._handlers: dict[str, Handler] = {}
        self._refused: dict[str, Refused] = {}
        self._connections: set[_ServedConnection] = set()
        self._messages: dict[str, _ServedConnection] = {}
        self._lock = threading.Lock()
        self.folder = folder
        self._container = container
        self._sparing = Sparing(log)
        self._closed = threading.Event()
        self.on_change: Callable[[], object] = lambda: None
        """Called when a connection for messages begins or ends; must not block."""
        self.warning = AcceptWarning(f"container '{container}'")
        self._paths = socket_path(folder, container), gateway_path(folder, container)
        kinds = socket.SOCK_STREAM, socket.SOCK_DGRAM
        self._neighbours, self._from_gateway = map(_bound, self._paths, kinds)
        self._neighbours.listen(64)
        threads.daemon(self._main, "accept").start()

    def open(
        self, connector: str, handler: Handler, refused: Refused = lambda: None
    ) -> None:
        """Receive the frames of `connector` from now on."""
        self._refused[connector] = refused
        self._handlers[connector] = handler

    def shut(self, connector: str) -> None:
        """Receive no more of its frames; harmless when repeated."""
        self._handlers.pop(connector, None)
        self._refused.pop(connector, None)

    def is_joined(self, connector: str) -> bool:
        """Return whether a connection for the messages of `connector` is there."""
        return connector in self._messages

    def close(self) -> None:
        """Close the sockets and every connection; harmless when repeated."""
        if self._closed.is_set():
            return
        self._handlers.clear()
        self._closed.set()
        for listening in (self._neighbours, self._from_gateway):
            with contextlib.suppress(OSError):
                listening.shutdown(socket.SHUT_RDWR)
        with self._lock:
            connections = list(self._connections)
        for served in connections:
            served.connection.end(socket.SHUT_RD)  # calls that came are still answered
        deadline = time.monotonic() + LAST_LIMIT
        for served in connections:
            if served.thread is not threading.current_thread():
                served.thread.join(max(0.0, deadline - time.monotonic()))
            served.connection.end()
        for path in self._paths:
            path.unlink(missing_ok=True)

    def _main(self) -> None:
        with self._neighbours, self._from_gateway:
            threads.keep_at(self._accept)

    def _accept(self) -> None:
        poll = select.poll()
        poll.register(self._neighbours, select.POLLIN)
        poll.register(self._from_gateway, select.POLLIN)
        while not self._closed.is_set():
            ready = {file for file, _ in poll.poll()}
            try:
                if self._neighbours.fileno() in ready:
                    self._start(self._neighbours.accept()[0])
                if self._from_gateway.fileno() in ready:
                    self._start(_handed_over(self._from_gateway), own_keys())
            except OSError as error:
                if not self._closed.is_set():
                    self.warning.note(error)
                    self._closed.wait(_PAUSE)

    def _start(self, sock: socket.socket, keys: Credentials | None = None) -> None:
        connection = Connection(sock)
        served = _ServedConnection(connection, threading.current_thread())
        served.thread = threads.daemon(self._serve, "connection", served, keys)
        trouble: RuntimeError | None = None
        with self._lock:
            if len(self._connections) >= _MOST_CONNECTIONS:
                trouble = RuntimeError(f"it has {_MOST_CONNECTIONS} already")
            elif not self._closed.is_set():
                try:
                    served.thread.start()
                except RuntimeError as error:  # other threads may end
                    trouble = error
                else:
                    self._connections.add(served)
                    return
        if trouble is not None:
            self.warning.note(trouble)
        connection.close()

    def _serve(self, served: _ServedConnection, keys: Credentials | None) -> None:
        connection.note_served(served.connection)
        try:
            if keys is not None:
                self._secure(served.connection, keys)
            self._greet(served)
            while self._serve_one(served):
                pass
        except WireError as error:
            log.warning("connector %s: refused: %s", served.connector, error)
        except (Unavailable, Timeout):
            pass
        finally:
            with self._lock:
                self._connections.discard(served)
                if self._messages.get(served.connector) is served:
                    del self._messages[served.connector]
            served.connection.close()
            self.on_change()

    def _secure(self, connection: Connection, keys: Credentials) -> None:
        try:
            connection.accept_tls(keys, time.monotonic() + ANSWER_LIMIT)
        except (Unavailable, Timeout) as error:
            text = "container '%s': another computer is refused: %s"
            self._sparing.warn("refused", text, self._container, error)
            raise

    def _greet(self, served: _ServedConnection) -> None:
        connection, deadline = served.connection, time.monotonic() + ANSWER_LIMIT
        try:
            hello = connection.receive(deadline)
            name: str = hello.value(NAME)
            self._raise_if_unknown(name)
        except (WireError, Unavailable) as error:
            connection.send(frame.segments(NAME, str(error), FrameKind.ERROR), deadline)
            raise
        served.connector, served.use = name, hello.number
        before = None
        if served.use == MESSAGES:
            with self._lock:  # of two that come at once, each waits for another
                before = self._messages.get(name)
                self._messages[name] = served
            self.on_change()
        connection.send(frame.segments(NAME, name, FrameKind.HELLO), deadline)
        if before is not None:
            peer = connection.peer()
            is_back = peer and peer == before.connection.peer()
            _wait_until_taken(before, _RESENDING if is_back else _PATIENCE)

    def _raise_if_unknown(self, connector: str) -> None:
        if connector not in self._handlers:
            # usual while a robot starts: the sender tries again
            raise Unavailable(NOT_HERE)

    def _serve_one(self, served: _ServedConnection) -> bool:
        connection, connector = served.connection, served.connector
        try:
            received = connection.receive()
        except WireError as error:
            if refused := self._refused.get(connector):
                refused()
            return self._refuse(served, error)
        handler = self._handlers.get(connector)
        if handler is None:
            return False
        answer = handler(received)
        del received  # its shared memory may be used again
        if answer is not None:
            deadline = time.monotonic() + _TAKE_LIMIT
            try:
                connection.send(answer, deadline)
            except WireError as error:  # it is too large
                connection.send(frame.failure("WireError", str(error)), deadline)
        return True

    def _refuse(self, served: _ServedConnection, error: WireError) -> bool:
        """Answer a malformed frame; return whether the connection goes on."""
        is_last = isinstance(error, Unreadable)
        if served.use != MESSAGES:
            number = LAST_ANSWER if is_last else 0
            pieces = frame.failure("WireError", str(error), number=number)
            served.connection.send(pieces, time.monotonic() + _TAKE_LIMIT)
        log.warning("connector %s: refused: %s", served.connector, error)
        return not is_last


def _bound(path: Path, kind: socket.SocketKind) -> socket.socket:
    """Return a socket at a path, where a killed container may have left one."""
    path.unlink(missing_ok=True)
    bound = socket.socket(socket.AF_UNIX, kind)
    try:
        keep_private(bound)
        bound.bind(os.fspath(path))
        bound.setblocking(False)
    except OSError:
        bound.close()
        raise
    return bound


def _handed_over(gateway: socket.socket) -> socket.socket:
    """Return a connection from the gateway; OSError when there is none."""
    data, files, _, _ = socket.recv_fds(gateway, 1, 1)
    if not data:
        raise BlockingIOError
    if not files:  # the kernel closed it, because this process may open no more
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
    return socket.socket(fileno=files[0])


def _wait_until_taken(before: _ServedConnection, patience: float) -> None:
    """Wait for what was sent over the replaced connection, to keep the order.

    `patience`: the silence that ends it [s].
    """
    before.thread.join(patience)
    while before.thread.is_alive():
        # sooner, it would lose what the sender's computer still has to send
        if before.connection.is_drained(patience):
            before.connection.end(socket.SHUT_RD)
        before.thread.join(patience)
        log.info("connector %s: older messages are being handled", before.connector)
