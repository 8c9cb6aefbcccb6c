"""Two Python processes and an AF_UNIX socket: the floor."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.calls.timing import Trips, payload, read, timed


def serve(folder: Path, ready: Callable[[], None]) -> None:
    """Send back what comes, piece by piece."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(folder / "s"))
        listener.listen(1)
        ready()
        connection, _ = listener.accept()
        buffer = bytearray(1 << 16)
        view = memoryview(buffer)
        while count := connection.recv_into(view):
            connection.sendall(view[:count])


@contextmanager
def connect(folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.connect(str(folder / "s"))
        received = memoryview(bytearray(6 << 20))

        def echo(data: bytes) -> None:
            # pieces that both socket buffers hold, or both ends would wait in send
            for start in range(0, len(data), 1 << 16):
                piece = data[start : start + (1 << 16)]
                connection.sendall(piece)
                left = received[: len(piece)]
                while left:
                    left = left[connection.recv_into(left) :]
            read(received[: len(data)])

        yield lambda size, count: timed(echo, payload(size), count)
