"""The address of a container: on this computer, or behind the gateway of another."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import struct
from hashlib import blake2s
from pathlib import Path
from typing import Self
from weakref import WeakSet

from msgspec import Struct

from poise.endpoint import Endpoint
from poise.wire.codec import WireError

LOST_AFTER = 4.0
"""A computer that is silent for this time is lost: its connections end [s].

Longer than the 3.0 to 3.7 s after which TCP sends for the fourth time again what got
lost (at 0.2, 0.6, 1.4 and 3.0 s, by its shortest pause of 0.2 s): else a cut of 1.5 to
3 s, that is over by then, would lose what was on its way.
"""
KEYS = "POISE_KEYS"
"""Environment variable: the folder of keys (`poise.wire.credentials`); empty: none."""
_PROBE_EVERY = 1
TCP_RTO_MAX_MS, RESEND_EVERY = 44, 1000
"""The pauses between retransmissions double up to this [ms], the shortest limit that
there is, or after a cut of 3 s it is silent for 3 s more; before Linux 6.15 it is."""
_CONTAINER = re.compile(r"[\w.-]+")


class Address(Struct, frozen=True):
    """The address of a container."""

    container: str  # Its name
    # The gateway of its computer; None: it is on this computer
    gateway: Endpoint | None = None

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the address that `str` gives as `text`."""
        before, slash, container = text.rpartition("/")
        if _CONTAINER.fullmatch(container):
            if not slash:
                return cls(container)
            try:
                gateway = Endpoint.parse(before, port=0)
            except ValueError:
                gateway = Endpoint("", 0)
            if gateway.is_ip and gateway.port:
                return cls(container, gateway)
        raise WireError(
            f"'{text}' is not the address of a container: CONTAINER or "
            "IP-ADDRESS:PORT/CONTAINER"
        )

    def __str__(self) -> str:
        return f"{self.gateway}/{self.container}" if self.gateway else self.container


def family_of(host: str) -> socket.AddressFamily:
    """Return the address family of an IP address."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def tune(connection: socket.socket) -> None:
    """Make TCP send at once, and end when silent for `LOST_AFTER`."""
    seconds = int(LOST_AFTER)
    for level, option, value in (
        (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
        (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
        (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _PROBE_EVERY),
        (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _PROBE_EVERY),
        (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, seconds),
    ):
        connection.setsockopt(level, option, value)
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.IPPROTO_TCP, TCP_RTO_MAX_MS, RESEND_EVERY)


def peek(connection: socket.socket, count: int) -> bytes | None:
    """Return what a socket gives next, below any TLS; None: nothing has come yet."""
    try:
        flags = socket.MSG_PEEK | socket.MSG_DONTWAIT
        return socket.socket.recv(connection, count, flags)
    except BlockingIOError:
        return None


LONGEST = 107
"""The kernel takes no longer path of a socket [bytes]."""


def socket_path(folder: Path, container: str) -> Path:
    """Return the path of a container's socket, as short for a long name as for any."""
    name = blake2s(container.encode(), digest_size=8).hexdigest()
    path = folder / f"{name}.sock"
    length = len(os.fsencode(path))
    if length > LONGEST:
        room = LONGEST - (length - len(os.fsencode(folder)))
        raise ValueError(
            f"the path {folder} is {len(os.fsencode(folder))} bytes long, but sockets "
            f"in a folder need one of at most {room}: choose another (TMPDIR, --folder)"
        )
    return path


def gateway_path(folder: Path, container: str) -> Path:
    """Return where a container is handed connections, a path as long as the other."""
    return socket_path(folder, container).with_suffix(".gate")


def agent_path(folder: Path) -> Path:
    """Return the path of the socket at which an agent adopts containers."""
    return folder / "agent.sock"


def connect(connection: socket.socket, path: Path, limit: float) -> None:
    """Connect an AF_UNIX socket; wait up to `limit` [s] for a place in the queue."""
    seconds = int(limit)
    value = struct.pack("ll", seconds, max(1, int(1e6 * (limit - seconds))))
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, value)
    connection.connect(os.fspath(path))


_private: WeakSet[socket.socket] = WeakSet()


def keep_private(connection: socket.socket) -> None:
    """Let no forked process share a socket."""
    _private.add(connection)


def _let_go() -> None:
    try:
        unconnected = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    except OSError:  # no descriptor is free
        for connection in _private:
            connection.close()
        return
    with unconnected:
        # their numbers stay in use: whatever still sends there gets an error
        for connection in _private:
            if connection.fileno() >= 0:
                os.dup2(unconnected.fileno(), connection.fileno())


os.register_at_fork(after_in_child=_let_go)
