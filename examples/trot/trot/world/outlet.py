"""The simulator's end of a device: a Unix socket that several components may use."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

from trot.device import MOST, PACKET

BUFFER = 32_768
"""[bytes] What is kept for a component that does not read; then packets are lost."""

_LONGEST_PATH = 107
"""[bytes] What Linux takes as the path of a socket."""


class Outlet:
    """Serves one device file. Never blocks; clients come and go as they like."""

    def __init__(self, path: Path) -> None:
        if len(bytes(path)) > _LONGEST_PATH:
            raise ValueError(
                f"the socket '{path}' has a path of {len(bytes(path))} bytes, and "
                f"Linux takes {_LONGEST_PATH}: choose a shorter folder for the run"
            )
        path.unlink(missing_ok=True)
        self._path = path
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.setblocking(False)
        self._listener.bind(str(path))
        self._listener.listen()
        self._clients: list[socket.socket] = []

    @property
    def is_used(self) -> bool:
        """Whether anybody has opened the device."""
        self._accept()
        return bool(self._clients)

    def push(self, packet: bytes) -> None:
        """Send `packet` to every client; one whose buffer is full does not get it."""
        self._accept()
        for client in self._clients[:]:
            try:
                client.send(packet)
            except BlockingIOError:
                continue
            except OSError:
                self._drop(client)

    def poll(self) -> list[bytes]:
        """Return the packets that clients have sent, `MOST` of each at most."""
        self._accept()
        return [p for client in self._clients[:] for p in self._read(client)]

    def close(self) -> None:
        """Close everything and remove the file."""
        for each in [self._listener, *self._clients]:
            each.close()
        self._path.unlink(missing_ok=True)

    def _read(self, client: socket.socket) -> list[bytes]:
        packets: list[bytes] = []
        with contextlib.suppress(BlockingIOError):
            while len(packets) < MOST:
                try:
                    packet = client.recv(PACKET)
                except ConnectionError:
                    packet = b""
                if not packet:
                    self._drop(client)
                    break
                packets.append(packet)
        return packets

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                client, _ = self._listener.accept()
                client.setblocking(False)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
                self._clients.append(client)

    def _drop(self, client: socket.socket) -> None:
        client.close()
        self._clients.remove(client)
