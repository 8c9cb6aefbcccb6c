"""The gateway of a computer: where connections from other computers arrive.

It listens on one TCP port. The first frame of a connection names a container, and the
gateway hands the connection on to it. So containers need no ports, and a restarted
container keeps its address.

A connection that sends nothing or nonsense is closed: its first frame has a largest
size and a time limit. At most `_MOST` are read at a time; others wait in the kernel.
"""

from __future__ import annotations

import array
import contextlib
import logging
import os
import select
import socket
import threading
import time
from pathlib import Path
from typing import Self

from poise.endpoint import Endpoint
from poise.errors import CallError, RunError, Unavailable
from poise.wire import frame
from poise.wire.address import family_of, tune
from poise.wire.codec import WireError
from poise.wire.connections.accept_warning import AcceptWarning
from poise.wire.connections.connection import Connection
from poise.wire.connections.opening import ANSWER_LIMIT, NAME
from poise.wire.connections.socket_path import gateway_path
from poise.wire.frame import Kind
from poise.wire.record_channel import FrameReader

log = logging.getLogger(__name__)

SAY_LIMIT = 1.0
"""A new connection names its container within this time [s]."""
_LARGEST = 1024
"""A larger first frame is refused [bytes]."""
_MOST = 64
"""Connections that are read at a time."""
_BACKLOG = 128
_PAUSE = 0.01


class _Arrival:
    """A connection that has not named its container, or is not handed on yet."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.until = time.monotonic() + SAY_LIMIT
        self.container = ""
        self.is_refused = False
        self._frames = FrameReader(connection, _LARGEST)

    def read(self) -> None:
        """Read the container's name, and nothing behind it.

        Raises
        ------
        WireError
            It is not a frame with a name.
        Unavailable, OSError
            The connection has ended.
        """
        if self.is_refused:  # unread bytes would reset the answer
            if not self.connection.recv(_LARGEST):
                raise ConnectionResetError
            return
        hello = self._frames.next()
        if hello is None:
            return
        if hello.kind is not Kind.HELLO:
            raise WireError(f"a frame of the kind {hello.kind.name}, not a name")
        self.container = hello.value(NAME)
        self.until = time.monotonic() + ANSWER_LIMIT

    def refuse(self, why: str) -> None:
        """Send why; then wait for the other end to close."""
        self.is_refused = True
        self.until = time.monotonic() + SAY_LIMIT
        with contextlib.suppress(CallError, OSError):
            pieces = frame.segments(NAME, why, Kind.ERROR)
            Connection(self.connection).send(pieces, time.monotonic())
            self.connection.shutdown(socket.SHUT_WR)


class Gateway:
    """Listens for connections from other computers, on a thread of its own.

    Parameters
    ----------
    folder
        Where the sockets of this computer's containers are.
    host
        An IP address of this computer.
    port
        TCP port; 0: one that is free.

    Attributes
    ----------
    warning
        Knows whether connections are accepted.

    Raises
    ------
    RunError
        The address cannot be had.
    """

    def __init__(self, folder: Path, host: str, port: int = 0) -> None:
        self._folder = folder
        self._arrivals: dict[int, _Arrival] = {}
        self._closed = threading.Event()
        self.warning = AcceptWarning("the gateway")
        self._handing_on = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._listener = socket.create_server(
                (host, port), family=family_of(host), backlog=_BACKLOG
            )
        except OSError as error:
            self._handing_on.close()
            raise RunError(
                f"cannot listen on {Endpoint(host, port)}: {error}"
            ) from None
        self._address = str(Endpoint(*self._listener.getsockname()[:2]))
        tune(self._listener)
        self._listener.setblocking(False)
        self._thread = threading.Thread(target=self._main, name="gateway", daemon=True)
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
        with self._listener, self._handing_on:
            while not self._closed.is_set():
                ready = self._wait()
                if self._listener.fileno() in ready:
                    self._accept()
                for file in ready & self._arrivals.keys():
                    self._read(self._arrivals[file])
                for arrival in self._waiting():
                    self._hand_on(arrival)
                self._close_late()
            for arrival in self._arrivals.values():
                arrival.connection.close()

    def _wait(self) -> set[int]:
        """Wait for a connection, a name, or a time limit."""
        poll = select.poll()
        if len(self._arrivals) < _MOST:
            poll.register(self._listener, select.POLLIN)
        for file, arrival in self._arrivals.items():
            if not arrival.container or arrival.is_refused:
                poll.register(file, select.POLLIN)
        limits = (arrival.until for arrival in self._arrivals.values())
        until = min(limits, default=None)
        wait = None if until is None else 1000 * max(0.0, until - time.monotonic())
        if self._waiting():
            wait = 1000 * _PAUSE
        return {file for file, _ in poll.poll(wait)}

    def _waiting(self) -> list[_Arrival]:
        """Return those that named a container and are not handed on."""
        arrivals = self._arrivals.values()
        return [a for a in arrivals if a.container and a.until and not a.is_refused]

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            return
        except OSError as error:
            if not self._closed.is_set():
                self.warning.note(error)
                self._closed.wait(_PAUSE)
            return
        connection.setblocking(False)
        self._arrivals[connection.fileno()] = _Arrival(connection)

    def _read(self, arrival: _Arrival) -> None:
        try:
            arrival.read()
        except WireError as error:
            log.warning("a connection from %s is refused: %s", _peer(arrival), error)
            arrival.refuse(str(error))
        except (Unavailable, OSError):
            arrival.until = 0.0

    def _hand_on(self, arrival: _Arrival) -> None:
        container = arrival.container
        files = array.array("i", [arrival.connection.fileno()])
        rights = (socket.SOL_SOCKET, socket.SCM_RIGHTS, files)
        path = os.fspath(gateway_path(self._folder, container))
        try:
            self._handing_on.sendmsg([b"+"], [rights], socket.MSG_DONTWAIT, path)
        except (FileNotFoundError, ConnectionRefusedError):
            # usual while a robot starts: the sender tries again
            arrival.refuse(f"no container '{container}' is here")
        except BlockingIOError:
            if arrival.until <= time.monotonic():
                arrival.refuse(
                    f"container '{container}' took no connection within "
                    f"{ANSWER_LIMIT:g} s"
                )
        except OSError as error:
            arrival.refuse(f"container '{container}' accepts no connection: {error}")
        else:
            arrival.until = 0.0

    def _close_late(self) -> None:
        now = time.monotonic()
        for file, arrival in list(self._arrivals.items()):
            if arrival.until <= now:
                self._arrivals.pop(file).connection.close()


def _peer(arrival: _Arrival) -> str:
    with contextlib.suppress(OSError):
        return str(arrival.connection.getpeername()[0])
    return "an unknown address"
