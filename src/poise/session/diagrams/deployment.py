"""The deployment diagram of a robot: which computer runs what, for placements."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping

from poise.model.robot import Computer, Link, Robot
from poise.session.diagrams.records import (
    DeployedComponent,
    DeploymentDiagram,
    DeploymentNode,
    Path,
    Placed,
)
from poise.units import (
    counted,
    format_amount,
    format_bandwidth,
    format_bytes,
    format_seconds,
)

_MOST_CROSSING = 4
"""So many connectors between two computers are named; of more, how many there are."""


def deployment_diagram(
    robot: Robot, placements: Mapping[str, Mapping[str, str]]
) -> DeploymentDiagram:
    """Return placements (component -> computer) side by side, by their names.

    What is elsewhere than in the first one is marked.
    """
    first: Mapping[str, str] = next(iter(placements.values()), {})
    views = []
    for name, placement in placements.items():
        nodes = tuple(_node(robot, c, placement, first) for c in robot.computers)
        views.append(Placed(name, nodes, tuple(_paths(robot, placement))))
    return DeploymentDiagram(robot.name, tuple(views))


def _node(
    robot: Robot,
    computer: Computer,
    placement: Mapping[str, str],
    first: Mapping[str, str],
) -> DeploymentNode:
    here = [n for n, there in placement.items() if there == computer.name]
    demands = {each.name: each.demand for each in robot.components()}
    lines = []
    for resource in computer.capacity:
        usable = computer.usable(resource)
        used = sum(demands[name].get(resource, 0.0) for name in here)
        share = f"{used / usable:.0%} of " if usable and used else ""
        lines.append(f"{resource}: {share}{format_amount(resource, usable)}")
    devices = [d.name for d in robot.devices if d.computer == computer.name]
    lines += [f"devices: {', '.join(devices)}"] if devices else []
    parts = [
        DeployedComponent(name, _remark(name, computer.name, first))
        for name in sorted(here)
    ]
    return DeploymentNode(computer.name, tuple(lines), tuple(parts))


def _remark(name: str, computer: str, first: Mapping[str, str]) -> str:
    before = first.get(name)
    if before == computer:
        return ""
    return "starts" if before is None else f"from {before}"


def _paths(robot: Robot, placement: Mapping[str, str]) -> Iterator[Path]:
    """Yield a path for each two computers that are linked, or talk to each other."""
    links = {frozenset(link.between): link for link in robot.links}
    crossing: dict[frozenset[str], list[str]] = defaultdict(list)
    traffic: dict[frozenset[str], float] = defaultdict(float)
    for connector in robot.all_connectors():
        ends = [placement.get(end.component) for end in connector.between]
        if None not in ends and ends[0] != ends[1]:
            pair = frozenset(end for end in ends if end is not None)
            crossing[pair].append(" → ".join(e.component for e in connector.between))
            traffic[pair] += connector.traffic
    for pair in dict.fromkeys((*links, *crossing)):
        one, other = sorted(pair)
        lines = _path_lines(links.get(pair), crossing[pair], traffic[pair])
        yield Path((one, other), tuple(lines))


def _path_lines(
    link: Link | None, names: Iterable[str], traffic: float
) -> Iterator[str]:
    if link is not None and link.bandwidth < float("inf"):
        latency = f", {format_seconds(link.latency)}" if link.latency else ""
        yield f"{format_bandwidth(link.bandwidth)}{latency}"
    names = list(dict.fromkeys(names))
    if names:
        size = f", {format_bytes(traffic)}/s" if traffic else ""
        yield f"{counted(len(names), 'connector')}{size}"
    if len(names) <= _MOST_CROSSING:
        yield from names
