"""The simulator's end of a device: a Unix socket that several components may use."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path
from typing import Any

import msgspec

from sorter.device import packets


class Outlet:
    """Serves one device file. Never blocks; clients come and go as they like."""

    def __init__(self, path: Path) -> None:
        path.unlink(missing_ok=True)
        self._path = path
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.setblocking(False)
        self._listener.bind(str(path))
        self._listener.listen()
        self._clients: list[socket.socket] = []

    def push(self, *values: object) -> None:
        """Send a packet to every client; one whose buffer is full does not get it."""
        self._accept()
        packet = msgspec.msgpack.encode(values)
        for client in self._clients[:]:
            try:
                client.send(packet)
            except BlockingIOError:
                continue
            except OSError:
                self._drop(client)

    def poll(self) -> list[Any]:
        """Return what clients have sent, oldest first; nonsense is left out."""
        self._accept()
        found = []
        for client in self._clients[:]:
            for packet in packets(client):
                if not packet:
                    self._drop(client)
                    break
                with contextlib.suppress(msgspec.DecodeError):
                    found.append(msgspec.msgpack.decode(packet))
        return found

    def close(self) -> None:
        for each in (self._listener, *self._clients):
            each.close()
        self._path.unlink(missing_ok=True)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                client, _ = self._listener.accept()
                client.setblocking(False)
                self._clients.append(client)

    def _drop(self, client: socket.socket) -> None:
        client.close()
        self._clients.remove(client)
