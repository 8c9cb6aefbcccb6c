"""Network namespaces: one for each computer, and one for the switch between them.

A cable ends with its namespace, so removing the namespaces removes everything.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from poise.emulate.network.plan import Cable, NetworkPlan
from poise.errors import RunError

NAMESPACES = Path("/run/netns")
_LIMIT = 10.0
"""Time limit of `ip` and `tc` for a whole batch [s]."""
_LONGEST_QUEUE = "40ms"
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
    """Return the `tc` commands as (namespace, commands).

    Parameters
    ----------
    delays
        Whether the kernel can delay packets (netem); a delay is put where packets
        leave a computer.
    """
    ports = [
        f"qdisc add dev port{index} root {_rate(cable.bandwidth)}"
        for index, cable in enumerate(network.cables)
        if cable.bandwidth
    ]
    return [
        (network.switch, ports),
        *(
            (cable.namespace, _leaving(cable, delays=delays))
            for cable in network.cables
        ),
    ]


def build(network: NetworkPlan) -> None:
    """Make the namespaces and cables of `network`; RunError when `ip` refuses."""
    for namespace, commands in wiring(network):
        _run("ip", namespace, commands)


def shape(network: NetworkPlan, *, delays: bool) -> None:
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
    # It is also removed with the switch's namespace, but only some time later.
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
        f"link set eth0 {_NO_OFFLOAD} up",
    ]


def _leaving(cable: Cable, *, delays: bool) -> list[str]:
    commands, parent = [], "root"
    if delays and cable.latency:
        delay = f"{round(cable.latency * 1e6)}us"
        commands = [f"qdisc add dev eth0 root handle 1: netem delay {delay}"]
        parent = "parent 1:1"
    if cable.bandwidth:
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
    # A bucket of 1 ms holds several packets even on a slow link, and lasts between two
    # refills on a fast one.
    burst = max(16 * 1024, int(bandwidth * 0.001))
    bits = int(bandwidth * 8)
    return f"tbf rate {bits}bit burst {burst} latency {_LONGEST_QUEUE}"
