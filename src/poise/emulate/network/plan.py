"""The plan of an emulated network: names, addresses, bandwidths. Nothing is made here.

Each computer has one virtual cable, ``eth0``, to a bridge in the switch's namespace.
The owner's namespace has a cable too, unshaped, because it is no part of the robot.
"""

from __future__ import annotations

import ipaddress
import math
import socket
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path

from msgspec import Struct

from poise.emulate.owner import PREFIX, Owner
from poise.errors import RobotError, RunError
from poise.model.robot import Link

_MOST = 253


class Cable(Struct, frozen=True, kw_only=True):
    """How one computer is connected: its network namespace, its IP address there."""

    namespace: str
    address: str


class Shape(Struct, frozen=True, kw_only=True):
    """How a link is shaped.

    Parameters
    ----------
    bandwidth
        [bytes/s], each way; None: no limit.
    latency
        One way [s].
    """

    bandwidth: float | None = None
    latency: float = 0.0


class NetworkPlan(Struct, frozen=True, kw_only=True):
    """The whole network that `build` makes.

    Parameters
    ----------
    cables
        One for each computer, in the order of the robot file.
    links
        The two computers of each link, as indices of `cables`, and its shape.
    """

    switch: str
    owner: str
    owner_address: str
    cables: tuple[Cable, ...]
    links: tuple[tuple[int, int, Shape], ...] = ()

    @property
    def namespaces(self) -> tuple[str, ...]:
        """All namespaces, the switch's first."""
        return (self.switch, *(cable.namespace for cable in self.cables))


def plan_network(
    owner: Owner,
    number: int,
    computers: Sequence[str],
    links: Sequence[Link],
    taken: Iterable[str] = (),
) -> NetworkPlan:
    """Return the network for `computers` joined by `links`.

    Parameters
    ----------
    number
        Distinguishes the emulations of one owner.
    taken
        IP addresses of others, which may not be there yet.

    Raises
    ------
    RobotError
        When there are more computers than a subnet has addresses.
    """
    if len(computers) > _MOST:
        message = f"{len(computers)} computers cannot be emulated; at most {_MOST} can"
        raise RobotError(message)
    hosts = [str(host) for host in _free_subnet(owner.pid + number, taken).hosts()]
    cables = [
        Cable(namespace=f"{owner}-{number}-{index}", address=hosts[index])
        for index in range(len(computers))
    ]
    shaped = [
        (computers.index(one), computers.index(other), _shape(link))
        for link in links
        for one, other in [link.between]
        if {one, other} <= set(computers)
    ]
    return NetworkPlan(
        switch=f"{owner}-{number}-switch",
        owner=f"{PREFIX}{owner.pid}.{number % 100}",
        owner_address=hosts[-1],
        cables=tuple(cables),
        links=tuple(shaped),
    )


def _shape(link: Link) -> Shape:
    bandwidth = link.bandwidth if math.isfinite(link.bandwidth) else None
    return Shape(bandwidth=bandwidth, latency=link.latency)


def _free_subnet(start: int, taken: Iterable[str] = ()) -> ipaddress.IPv4Network:
    """Return a subnet of 10.0.0.0/8 without `taken`, and to which there is no route.

    Each owner starts its search elsewhere: those of two users, who do not know each
    other's, hardly collide.
    """
    others = [*_routes(), *map(ipaddress.IPv4Network, taken)]
    for step in range(256):
        number = (start + step) % 65536
        subnet = ipaddress.IPv4Network((0x0A000000 + (number << 8), 24))
        if not any(subnet.overlaps(other) for other in others):
            return subnet
    message = "no free subnet in 10.0.0.0/8 for the emulated network"
    raise RunError(message)


def _routes() -> list[ipaddress.IPv4Network]:
    """Return the networks that this host has routes to, without the default route."""
    found = []
    for line in Path("/proc/net/route").read_text().splitlines()[1:]:
        fields = line.split()
        # Addresses are numbers in the machine's byte order.
        target, mask = (
            socket.inet_ntoa(struct.pack("=L", int(fields[i], 16))) for i in (1, 7)
        )
        if mask != "0.0.0.0":  # noqa: S104 - nothing is bound here
            found.append(ipaddress.IPv4Network((target, mask)))
    return found
