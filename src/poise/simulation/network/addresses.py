"""Which computer, and which socket on it, has an address."""

from __future__ import annotations

from typing import TYPE_CHECKING

from poise.simulation.computers.process import Process

if TYPE_CHECKING:
    from poise.simulation.network.datagrams import SimulatedSocket

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
