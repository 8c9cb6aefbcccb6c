"""AF_UNIX sockets: their paths, connecting to one, and keeping them out of forks.

A forked process shares all open sockets, so the other end of a connection would not
notice that the container has ended; ``SOCK_CLOEXEC`` acts only at an exec.
"""

from __future__ import annotations

import os
import socket
import struct
from hashlib import blake2s
from pathlib import Path
from weakref import WeakSet

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
    """Return the path of the socket over which a container is handed connections."""
    return socket_path(folder, container).with_suffix(".gateway")


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
        for each in _private:
            each.close()
        return
    with unconnected:
        # their numbers stay in use: whatever still sends there gets an error
        for each in _private:
            if each.fileno() >= 0:
                os.dup2(unconnected.fileno(), each.fileno())


os.register_at_fork(after_in_child=_let_go)
