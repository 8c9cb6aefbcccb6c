"""The robot's end of a device: msgpack records in packets on a Unix socket.

The components and the simulated world share no other code than this, `cell` and the
arm's geometry. Times in packets are CLOCK_MONOTONIC [s], as real drivers give them.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import msgspec

NAMES = ("camera", "arm", "gripper", "scanner", "screen")
"""Of the devices, in the robot file and of their sockets."""

LARGEST = 65_536
"""[bytes] of a packet."""


class Device:
    """A connection to a device file, made when it is first used, and again when lost.

    Nothing here waits: a device that is away has no packets, and takes none.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._socket: socket.socket | None = None

    def newest(self) -> Any | None:  # noqa: ANN401, each device has a record of its own
        """Return what the newest packet holds; None when none came."""
        found = None
        for packet in packets(self._socket or self._connect()):
            if not packet:
                self.close()
                break
            found = packet
        return None if found is None else msgspec.msgpack.decode(found)

    def send(self, *values: object) -> None:
        """Send a packet; it is lost when the device is away or does not read."""
        try:
            if connection := self._socket or self._connect():
                connection.send(msgspec.msgpack.encode(values))
        except BlockingIOError:
            pass
        except OSError:
            self.close()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self) -> socket.socket | None:
        fresh = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        fresh.setblocking(False)
        try:
            fresh.connect(self._path)
        except OSError:
            fresh.close()
            return None
        self._socket = fresh
        return fresh


def packets(connection: socket.socket | None) -> Iterator[bytes]:
    """Yield what has arrived; an empty packet when the other end is gone."""
    while connection is not None:
        try:
            packet = connection.recv(LARGEST)
        except BlockingIOError:
            return
        except OSError:
            packet = b""
        yield packet
        if not packet:
            return
