"""The network of emulated computers: its plan, and the namespaces that carry it out.

Each computer has one virtual cable, ``eth0``, to a bridge in the switch's namespace.
The owner's cable is unshaped, for it is no part of the robot. All ends with namespaces.
"""

from __future__ import annotations

import ipaddress
import math
import os
import shutil
import socket
import struct
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

from msgspec import Struct

from poise.emulate.processes import PREFIX, Owner
from poise.errors import RobotError, RunError
from poise.model.robot import Link

_MOST = 253


class Cable(Struct, frozen=True, kw_only=True):
    """How one computer is connected: its network namespace, its IP address there."""

    namespace: str
    address: str


class Shape(Struct, frozen=True, kw_only=True):
    """How a link is shaped."""

    bandwidth: float | None = None  # [bytes/s], each way; None: no limit
    latency: float = 0.0  # one way [s]


class NetworkPlan(Struct, frozen=True, kw_only=True):
    """The whole network that `build` makes."""

    switch: str
    owner: str
    owner_address: str
    cables: tuple[Cable, ...]  # one for each computer, in the order of the robot file
    # the two computers of each link, as indices of `cables`, and its shape
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
    """Return the network for `computers` joined by `links`."""
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
    """Return a subnet of 10.0.0.0/8 without `taken`, and to which there is no route."""
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
    taken = []
    for line in Path("/proc/net/route").read_text().splitlines()[1:]:
        fields = line.split()
        # Addresses are numbers in the machine's byte order.
        target, mask = (
            socket.inet_ntoa(struct.pack("=L", int(fields[i], 16))) for i in (1, 7)
        )
        if mask != "0.0.0.0":  # noqa: S104 - nothing is bound here
            taken.append(ipaddress.IPv4Network((target, mask)))
    return taken


NAMESPACES = Path("/run/netns")
_LIMIT = 10.0
"""Time limit of `ip` and `tc` for a whole batch [s]."""
_LONGEST_QUEUE = 0.04
"""What waits longer than this before a link is dropped [s]."""
_NOBODY = "02:00:00:00:00:00"
"""A hardware address that no interface has."""
_LEAST, _UNLIMITED = 1.0, 1.25e10
"""The least bandwidth that `tc` takes, and that of a link without a limit, which is
more than a virtual one carries [bytes/s]."""
_PACKET = 1514
"""The largest packet [bytes]."""
_NO_OFFLOAD = "gso_max_segs 1"
"""Otherwise a "packet" of 64 KB crosses a virtual link as one, and traffic comes in
bursts."""


def wiring(network: NetworkPlan) -> list[tuple[str, list[str]]]:
    """Return the `ip` commands as (namespace, commands); "" is the owner's."""
    namespaces = [f"netns add {name}" for name in network.namespaces]
    bridge = ["link add bridge type bridge", "link set bridge up"]
    cables = [
        command
        for index, cable in enumerate(network.cables)
        for command in (
            f"link add port{index} type veth peer name eth0 netns {cable.namespace}",
            f"link set port{index} master bridge {_NO_OFFLOAD} up",
        )
    ]
    owner = [
        f"link add {network.owner} type veth peer name owner netns {network.switch}",
        f"addr add {network.owner_address}/24 dev {network.owner}",
        f"link set {network.owner} up",
    ]
    return [
        ("", namespaces),
        (network.switch, bridge + cables),
        *((cable.namespace, _inside(cable)) for cable in network.cables),
        ("", owner),
        (network.switch, ["link set owner master bridge up"]),
    ]


def shaping(network: NetworkPlan, *, delays: bool) -> list[tuple[str, list[str]]]:
    """Return `tc` commands by namespace: a class for each link at both ends."""
    commands: dict[int, list[str]] = {}
    for one, other, link in network.links:
        for source, target in ((one, other), (other, one)):
            inside = commands.setdefault(
                source, ["qdisc add dev eth0 root handle 1: htb"]
            )
            address = network.cables[target].address
            inside += _link_class(target, link, delays=delays)
            inside.append(
                "filter add dev eth0 parent 1: protocol ip prio 1 u32 "
                f"match ip dst {address}/32 flowid 1:{target + 1:x}"
            )
    return [(network.cables[i].namespace, command) for i, command in commands.items()]


def reshape(
    network: NetworkPlan, one: int, other: int, shape: Shape, *, delays: bool
) -> None:
    """Shape the link between two computers again; RunError when `tc` refuses."""
    for source, target in ((one, other), (other, one)):
        commands = _link_class(target, shape, delays=delays)
        _run("tc", network.cables[source].namespace, commands)


def build(network: NetworkPlan) -> None:
    """Make the namespaces and cables of `network`; RunError when `ip` refuses."""
    for namespace, commands in wiring(network):
        _run("ip", namespace, commands)


def shape(network: NetworkPlan, *, delays: bool) -> None:
    """Give the links their bandwidth and latency; RunError when `tc` refuses."""
    for namespace, commands in shaping(network, delays=delays):
        _run("tc", namespace, commands)


def detach(network: NetworkPlan, index: int) -> None:
    """Pull the other end of a computer's cable: packets vanish without a reset."""
    _run("ip", network.switch, [f"link set port{index} nomaster"])


def attach(network: NetworkPlan, index: int) -> None:
    """Put the cable in again."""
    _run("ip", network.switch, [f"link set port{index} master bridge"])


def cut(network: NetworkPlan, one: int, other: int) -> None:
    """Let packets between two computers vanish: their hardware addresses are wrong."""
    for source, target in ((one, other), (other, one)):
        address = network.cables[target].address
        command = f"neigh replace {address} lladdr {_NOBODY} nud permanent dev eth0"
        _run("ip", network.cables[source].namespace, [command])


def join(network: NetworkPlan, one: int, other: int) -> None:
    """End a cut between two computers."""
    for source, target in ((one, other), (other, one)):
        command = f"neigh del {network.cables[target].address} dev eth0"
        _run("ip", network.cables[source].namespace, [command])


def can_delay(namespace: str) -> bool:
    """Return whether the kernel can delay packets; leaves `namespace` as it was."""
    try:
        _run("tc", namespace, ["qdisc add dev lo root netem delay 1ms"])
        _run("tc", namespace, ["qdisc del dev lo root"])
    except RunError:
        return False
    return True


def unplug(interface: str) -> None:
    """Remove the owner's end of a cable; nothing happens when it is gone."""
    # It is also removed with the switch's namespace, but only some time later.
    if interface in (name for _, name in socket.if_nameindex()):
        _run("ip", "", [f"link del {interface}"])


def remove(namespace: str) -> None:
    """Remove a namespace and the cables in it; nothing happens when it is gone."""
    if (NAMESPACES / namespace).exists():
        _run("ip", "", [f"netns del {namespace}"])


def _inside(cable: Cable) -> list[str]:
    return [
        "link set lo up",
        f"addr add {cable.address}/24 dev eth0",
        f"link set eth0 {_NO_OFFLOAD} up",
    ]


def _link_class(target: int, shape: Shape, *, delays: bool) -> list[str]:
    """Return what shapes packets to a computer, whether or not they are already."""
    minor = f"{target + 1:x}"
    rate = min(max(shape.bandwidth or _UNLIMITED, _LEAST), _UNLIMITED)
    # A bucket of 1 ms holds several packets even on a slow link, and lasts between two
    # refills on a fast one.
    burst = max(16 * 1024, int(rate * 0.001))
    limit = int(rate * _LONGEST_QUEUE) + burst
    queue = f"bfifo limit {limit}"
    if delays and shape.latency:
        under_way = int(rate * shape.latency)
        queue = (
            f"netem delay {round(shape.latency * 1e6)}us "
            f"limit {(limit + under_way) // _PACKET}"
        )
    bucket = f"burst {burst} cburst {burst} quantum {_PACKET}"
    rate_class = f"htb rate {int(rate * 8)}bit {bucket}"
    return [
        f"class replace dev eth0 parent 1: classid 1:{minor} {rate_class}",
        f"qdisc replace dev eth0 parent 1:{minor} {queue}",
    ]


def find_tool(name: str) -> str | None:
    """Return where ``ip`` or ``tc`` is: only root has /usr/sbin in PATH on Debian."""
    path = os.environ.get("PATH", os.defpath)
    return shutil.which(name, path=f"{path}:/usr/sbin:/sbin")


def _run(tool: str, namespace: str, commands: Sequence[str]) -> None:
    within = ["-n", namespace] if namespace else []
    where = f" in namespace {namespace}" if namespace else ""
    try:
        done = subprocess.run(  # noqa: S603 - no shell; the names are our own
            [find_tool(tool) or tool, *within, "-batch", "-"],
            input="\n".join(commands) + "\n",
            capture_output=True,
            text=True,
            timeout=_LIMIT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        message = f"{tool} took over {_LIMIT:g} s{where}: {commands[0]} ..."
        raise RunError(message) from None
    if done.returncode:
        message = f"{tool} failed{where}: {done.stderr.strip()}"
        raise RunError(message)
