"""The robot's end of a device: packets on a Unix socket."""

from __future__ import annotations

import contextlib
import select
import socket

PACKET = 65_536
"""[bytes] The largest packet of any device."""

MOST = 64
"""Packets that one `receive` returns at most."""


class Device:
    """A connection to a device file, made when it is first used, and again when lost.

    Nothing here waits longer than it is told to, and a device that is away is not an
    error: then nothing is received, and `send` returns False.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._socket: socket.socket | None = None

    def receive(self, timeout: float = 0.0) -> list[bytes]:
        """Return the packets that are there, oldest first.

        When there is none it waits for the first one, for `timeout` [s] at most.
        """
        packets: list[bytes] = []
        connection = self._connected()
        if connection is None:
            return packets
        if timeout > 0:
            select.select([connection], [], [], timeout)
        with contextlib.suppress(BlockingIOError):
            while len(packets) < MOST:
                packet = self._take(connection)
                if not packet:
                    self.close()
                    break
                packets.append(packet)
        return packets

    def send(self, packet: bytes) -> bool:
        """Send `packet`; False when the device is away or does not read."""
        connection = self._connected()
        if connection is None:
            return False
        try:
            connection.send(packet)
        except BlockingIOError:
            return False
        except OSError:
            self.close()
            return False
        return True

    def close(self) -> None:
        """Give the connection back."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _take(self, connection: socket.socket) -> bytes:
        try:
            return connection.recv(PACKET)
        except ConnectionError:
            return b""

    def _connected(self) -> socket.socket | None:
        if self._socket is None:
            fresh = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            fresh.setblocking(False)
            try:
                fresh.connect(self.path)
            except OSError:
                fresh.close()
                return None
            self._socket = fresh
        return self._socket
