"""A network of namespaces: one for each computer, and one that is the switch.

Every computer has one virtual cable, ``eth0``, to a bridge in the switch's namespace.
The owner's own namespace gets a cable, too, unshaped, as it is no part of the robot.
Cables end where their namespace ends, so removing the namespaces removes everything.
"""

from __future__ import annotations

import ipaddress
import math
import socket
import struct
import subprocess
from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct

from poise.emulate.offload import offload_off
from poise.emulate.owner import PREFIX, Owner
from poise.errors import RobotError, RunError
from poise.model.robot import Link

NAMESPACES = Path("/run/netns")
_LIMIT = 10.0
"""How long `ip` or `tc` may take for its whole batch [s]."""
_LONGEST_QUEUE = "40ms"
_MOST = 253


class Cable(Struct, frozen=True, kw_only=True):
    """How one computer is connected.

    Parameters
    ----------
    namespace, address
        Its network namespace and its IP address there.
    bandwidth
        [bytes/s], each way; infinite: not shaped.
    latency
        One way [s].
    """

    namespace: str
    address: str
    bandwidth: float = math.inf
    latency: float = 0.0


class Plan(Struct, frozen=True, kw_only=True):
    """The whole network: what `build` makes."""

    switch: str
    owner: str
    owner_address: str
    cables: tuple[Cable, ...]

    @property
    def namespaces(self) -> tuple[str, ...]:
        """All namespaces, the switch's first."""
        return (self.switch, *(cable.namespace for cable in self.cables))


def plan(
    owner: Owner, number: int, computers: Sequence[str], links: Sequence[Link]
) -> Plan:
    """Return the network for `computers` joined by `links`.

    `number` tells the emulations of one owner apart.

    A computer has one cable for all its links, as wide as the widest and as long as
    the longest of them: computers that are joined by links of different kinds get
    more than the robot file says from the narrower ones.

    Raises
    ------
    RobotError
        When there are more computers than a subnet has addresses.
    """
    if len(computers) > _MOST:
        message = f"{len(computers)} computers cannot be emulated; at most {_MOST} can"
        raise RobotError(message)
    hosts = [str(host) for host in _free_subnet(owner.pid + number).hosts()]
    cables = [
        Cable(
            namespace=f"{owner}-{number}-{index}",
            address=hosts[index],
            bandwidth=max((link.bandwidth for link in mine), default=math.inf),
            latency=max((link.latency for link in mine), default=0.0),
        )
        for index, name in enumerate(computers)
        for mine in [[link for link in links if name in link.between]]
    ]
    return Plan(
        switch=f"{owner}-{number}-switch",
        owner=f"{PREFIX}{owner.pid}.{number % 100}",
        owner_address=hosts[-1],
        cables=tuple(cables),
    )


def wiring(network: Plan) -> list[tuple[str, list[str]]]:
    """Return the `ip` commands: (namespace they are for, "" the owner's; commands)."""
    namespaces = [f"netns add {name}" for name in network.namespaces]
    bridge = ["link add bridge type bridge", "link set bridge up"]
    cables = [
        command
        for index, cable in enumerate(network.cables)
        for command in (
            f"link add port{index} type veth peer name eth0 netns {cable.namespace}",
            f"link set port{index} master bridge up",
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


def shaping(network: Plan, *, delays: bool) -> list[tuple[str, list[str]]]:
    """Return the `tc` commands: (namespace they are for; commands).

    Parameters
    ----------
    delays
        Whether the kernel can delay packets (netem); a delay is put where packets
        leave a computer.
    """
    ports = [
        f"qdisc add dev port{index} root {_rate(cable.bandwidth)}"
        for index, cable in enumerate(network.cables)
        if math.isfinite(cable.bandwidth)
    ]
    return [
        (network.switch, ports),
        *(
            (cable.namespace, _leaving(cable, delays=delays))
            for cable in network.cables
        ),
    ]


def build(network: Plan) -> None:
    """Make the namespaces and cables of `network`; RunError when `ip` refuses."""
    for namespace, commands in wiring(network):
        _run("ip", namespace, commands)
    ports = [f"port{index}" for index, _ in enumerate(network.cables)]
    offload_off(NAMESPACES / network.switch, ports)
    for cable in network.cables:
        offload_off(NAMESPACES / cable.namespace, ["eth0"])


def shape(network: Plan, *, delays: bool) -> None:
    """Give the cables their bandwidth and latency; RunError when `tc` refuses."""
    for namespace, commands in shaping(network, delays=delays):
        _run("tc", namespace, commands)


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
    # It would go with the switch's namespace, but only some time later.
    if Path("/sys/class/net", interface).exists():
        _run("ip", "", [f"link del {interface}"])


def remove(namespace: str) -> None:
    """Remove a namespace and the cables in it; nothing happens when it is gone."""
    if (NAMESPACES / namespace).exists():
        _run("ip", "", [f"netns del {namespace}"])


def _inside(cable: Cable) -> list[str]:
    return [
        "link set lo up",
        f"addr add {cable.address}/24 dev eth0",
        "link set eth0 up",
    ]


def _leaving(cable: Cable, *, delays: bool) -> list[str]:
    commands, parent = [], "root"
    if delays and cable.latency:
        delay = f"{round(cable.latency * 1e6)}us"
        commands = [f"qdisc add dev eth0 root handle 1: netem delay {delay}"]
        parent = "parent 1:1"
    if math.isfinite(cable.bandwidth):
        commands += [f"qdisc add dev eth0 {parent} {_rate(cable.bandwidth)}"]
    return commands


def _run(tool: str, namespace: str, commands: Sequence[str]) -> None:
    within = ["-n", namespace] if namespace else []
    where = f" in namespace {namespace}" if namespace else ""
    try:
        done = subprocess.run(  # noqa: S603 - no shell; the names are our own
            [tool, *within, "-batch", "-"],
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


def _rate(bandwidth: float) -> str:
    # A bucket of 1 ms holds several packets even on a slow link and does not let a
    # quick one starve between two refills.
    burst = max(16 * 1024, int(bandwidth * 0.001))
    bits = int(bandwidth * 8)
    return f"tbf rate {bits}bit burst {burst} latency {_LONGEST_QUEUE}"


def _free_subnet(start: int) -> ipaddress.IPv4Network:
    """Return a subnet of 10.0.0.0/8 that this host has no route to.

    Each owner starts to look elsewhere, so that two that start at once do not meet.
    """
    taken = _routes()
    for step in range(256):
        number = (start + step) % 65536
        subnet = ipaddress.IPv4Network((0x0A000000 + (number << 8), 24))
        if not any(subnet.overlaps(route) for route in taken):
            return subnet
    message = "no free subnet in 10.0.0.0/8 for the emulated network"
    raise RunError(message)


def _routes() -> list[ipaddress.IPv4Network]:
    """Return the networks that this host has routes to, save the default route's."""
    found = []
    for line in Path("/proc/net/route").read_text().splitlines()[1:]:
        fields = line.split()
        # Addresses stand there as numbers in the machine's own byte order.
        target, mask = (
            socket.inet_ntoa(struct.pack("=L", int(fields[i], 16))) for i in (1, 7)
        )
        if mask != "0.0.0.0":  # noqa: S104 - nothing is bound here
            found.append(ipaddress.IPv4Network((target, mask)))
    return found
