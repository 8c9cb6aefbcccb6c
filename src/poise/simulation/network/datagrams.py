"""UDP sockets of the code under test."""

from __future__ import annotations

import errno
import socket
from collections import deque
from functools import partial
from math import inf

from poise.simulation.network.network import Network
from poise.simulation.robot.simulated_process import Process
from poise.simulation.schedule.scheduler import SimulatedTask, SimulationError

_FIRST_FREE = 32768
Address = tuple[str, int]


class Addresses:
    """The IP addresses of a robot's computers, and the UDP sockets that are bound."""

    def __init__(self) -> None:
        self._hosts: dict[str, str] = {}
        self._bound: dict[Address, SimulatedSocket] = {}
        self._free = _FIRST_FREE

    def add(self, computer: str) -> str:
        """Return the IP address of a new computer."""
        host = f"10.0.{len(self._hosts) // 250}.{len(self._hosts) % 250 + 1}"
        self._hosts[host] = computer
        return host

    def host_of(self, computer: str) -> str:
        """Return a computer's IP address."""
        return next(host for host, name in self._hosts.items() if name == computer)

    def computer_at(self, address: Address) -> str | None:
        """Return the computer with an address; None: there is none."""
        return self._hosts.get(address[0])

    def bound(self, address: Address) -> SimulatedSocket | None:
        """Return the socket that receives at an address."""
        return self._bound.get(address)

    def bind(
        self, process: Process, to: SimulatedSocket, address: Address | None = None
    ) -> Address:
        """Let a socket receive at an address; None: at a free one of its computer."""
        if address is None:
            self._free += 1
            address = self.host_of(process.computer.name), self._free
        self._bound[address] = to
        return address

    def release(self, address: Address, bound: SimulatedSocket) -> None:
        """Let a socket receive there no more."""
        if self._bound.get(address) is bound:
            del self._bound[address]


_MOST = 256
"""A socket keeps so many datagrams that nobody has read; further ones are lost."""


class SimulatedSocket:
    """A UDP socket, as far as heartbeats use one."""

    def __init__(
        self, addresses: Addresses, network: Network, process: Process, *kind: int
    ) -> None:
        if len(kind) < 2 or kind[1] != socket.SOCK_DGRAM:  # noqa: PLR2004
            raise SimulationError(
                f"{process.name} opens a socket {kind}: only UDP is simulated"
            )
        self._addresses = addresses
        self._network = network
        self._process = process
        self._waiting: deque[tuple[bytes, Address]] = deque()
        self._reader: SimulatedTask | None = None
        self._limit = inf
        self._address = addresses.bind(process, self)
        process.on_end.append(self.close)

    def bind(self, address: Address) -> None:
        """Receive what is sent to an address."""
        taken = self._addresses.bound(address)
        if taken is not None and taken is not self:
            raise OSError(errno.EADDRINUSE, f"{address} is in use")
        self._addresses.release(self._address, self)
        self._address = self._addresses.bind(self._process, self, address)

    def settimeout(self, limit: float) -> None:
        """Let `recvfrom` wait for up to `limit` [s]."""
        self._limit = limit

    def sendto(self, data: bytes, address: Address) -> int:
        """Send a datagram."""
        own, target = self._address, self._addresses.computer_at(address)
        if target is None:
            raise OSError(errno.EHOSTUNREACH, f"nothing is at {address}")

        source, size = self._process.computer.name, len(data)
        deliver = partial(self._deliver, address, data, own)
        self._network.send_datagram(source, target, size, deliver)
        return size

    def recvfrom(self, _size: int) -> tuple[bytes, Address]:
        """Return the next datagram and its sender's address."""
        scheduler = self._process.scheduler
        if not self._waiting:
            self._reader = scheduler.current
            scheduler.wait(self._limit, "a datagram")
            self._reader = None
        if not self._waiting:
            raise TimeoutError
        return self._waiting.popleft()

    def take(self, data: bytes, source: Address) -> None:
        """Keep a datagram that arrived; for the simulated world."""
        if len(self._waiting) < _MOST:
            self._waiting.append((data, source))
        if self._reader is not None:
            self._process.scheduler.wake(self._reader)

    def _deliver(self, address: Address, data: bytes, source: Address) -> None:
        receiver = self._addresses.bound(address)
        if receiver is not None:
            receiver.take(data, source)

    def close(self) -> None:
        """Receive no more."""
        self._addresses.release(self._address, self)
