"""The door of a computer: where links from other computers come in.

It listens on one TCP port. The first frame of a link names a container; the door then
hands the connection on to that container, which takes it as if it had come there. So
containers need no ports, and one that is started anew is reached where it was.

Who says nothing, or nonsense, is let go: a first frame has a largest size and a time
limit, and no more than some are waited for at a time; others wait in the kernel.
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
from poise.errors import CallError, RunError
from poise.wire import frame
from poise.wire.address import family_of, tune
from poise.wire.codec import WireError
from poise.wire.connections.connection import HEAD, Connection
from poise.wire.connections.opening import NAME
from poise.wire.connections.socket_path import gateway_path
from poise.wire.frame import Kind

log = logging.getLogger(__name__)

SAY_LIMIT = 1.0
"""Whoever comes says within this time where to [s]."""
_LARGEST = 1024
"""No first frame is larger [bytes]."""
_MOST = 64
"""So many may be about to say where to."""
_BACKLOG = 128
_PAUSE = 0.01


class _Visitor:
    """A connection that has not said where to, or waits until it is taken there."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.until = time.monotonic() + SAY_LIMIT
        self.container = ""
        self.is_refused = False
        self._data = bytearray()

    def hear(self) -> None:
        """Take what has come, until that is the container's name.

        Nothing behind the name is taken: that is for the container.

        Raises
        ------
        WireError
            It is no frame with a name.
        OSError
            The connection has ended, or there is nothing to take.
        """
        data = self.connection.recv(_LARGEST if self.is_refused else self._missing())
        if not data:
            raise ConnectionResetError
        if self.is_refused:  # it need only take in why, before it sees the end
            return
        self._data += data
        if self._missing():
            return
        hello = frame.parse(bytes(self._data[HEAD.size :]))
        if hello.kind is not Kind.HELLO:
            raise WireError(f"a frame of the kind {hello.kind.name}, not a name")
        self.container = hello.value(NAME)

    def refuse(self, why: str) -> None:
        """Tell it why, and take nothing more of it."""
        self.is_refused = True
        with contextlib.suppress(CallError, OSError):
            pieces = frame.segments(NAME, why, Kind.ERROR)
            Connection(self.connection).send(pieces, time.monotonic())
            self.connection.shutdown(socket.SHUT_WR)

    def _missing(self) -> int:
        if len(self._data) < HEAD.size:
            return HEAD.size - len(self._data)
        length, block = HEAD.unpack_from(self._data)
        if length > _LARGEST or block:
            raise WireError(f"a first frame of {length} B; {_LARGEST} B is the largest")
        return int(HEAD.size + length - len(self._data))


class Gateway:
    """Listens for links from other computers, on a thread of its own.

    Parameters
    ----------
    folder
        Where the sockets of this computer's containers are.
    host
        An IP address of this computer.
    port
        TCP port; 0: one that is free.

    Raises
    ------
    RunError
        The address cannot be had.
    """

    def __init__(self, folder: Path, host: str, port: int = 0) -> None:
        self._folder = folder
        self._guests: dict[int, _Visitor] = {}
        self._closed = threading.Event()
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
        self._thread = threading.Thread(target=self._main, name="door", daemon=True)
        self._thread.start()

    def __str__(self) -> str:
        """Return its IP address and port."""
        return self._address

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let nobody in any more; what was handed on stays."""
        self._closed.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join()

    def _main(self) -> None:
        with self._listener, self._handing_on:
            while not self._closed.is_set():
                ready = self._wait()
                if self._listener.fileno() in ready:
                    self._let_in()
                for file in ready & self._guests.keys():
                    self._attend(self._guests[file])
                for guest in self._waiting():
                    self._hand_on(guest)
                self._let_go()
            for guest in self._guests.values():
                guest.connection.close()

    def _wait(self) -> set[int]:
        """Wait for somebody who comes, speaks or should be let go."""
        poll = select.poll()
        if len(self._guests) < _MOST:
            poll.register(self._listener, select.POLLIN)
        for file, guest in self._guests.items():
            if not guest.container or guest.is_refused:
                poll.register(file, select.POLLIN)
        until = min((guest.until for guest in self._guests.values()), default=None)
        wait = None if until is None else 1000 * max(0.0, until - time.monotonic())
        if self._waiting():
            wait = 1000 * _PAUSE
        return {file for file, _ in poll.poll(wait)}

    def _waiting(self) -> list[_Visitor]:
        """Return those who said where to, and are not there."""
        guests = self._guests.values()
        return [g for g in guests if g.container and g.until and not g.is_refused]

    def _let_in(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            return
        except OSError:  # it gave up, or no file is free at the moment
            self._closed.wait(_PAUSE)
            return
        connection.setblocking(False)
        self._guests[connection.fileno()] = _Visitor(connection)

    def _attend(self, guest: _Visitor) -> None:
        try:
            guest.hear()
        except WireError as error:
            log.warning("a connection from %s is refused: %s", _peer(guest), error)
            guest.refuse(str(error))
        except BlockingIOError:
            pass
        except OSError:
            guest.until = 0.0

    def _hand_on(self, guest: _Visitor) -> None:
        container = guest.container
        files = array.array("i", [guest.connection.fileno()])
        rights = (socket.SOL_SOCKET, socket.SCM_RIGHTS, files)
        path = os.fspath(gateway_path(self._folder, container))
        try:
            self._handing_on.sendmsg([b"+"], [rights], socket.MSG_DONTWAIT, path)
        except (FileNotFoundError, ConnectionRefusedError):
            # usual while a robot starts: the sender asks again
            guest.refuse(f"no container '{container}' is here")
        except BlockingIOError:
            pass  # many come at once: it is asked again until the guest is let go
        except OSError as error:
            guest.refuse(f"container '{container}' takes nobody in: {error}")
        else:
            guest.until = 0.0

    def _let_go(self) -> None:
        now = time.monotonic()
        for file, guest in list(self._guests.items()):
            if guest.until <= now:
                self._guests.pop(file).connection.close()


def _peer(guest: _Visitor) -> str:
    with contextlib.suppress(OSError):
        return str(guest.connection.getpeername()[0])
    return "somebody"
