"""Cycles of calls: two call chains in one would deadlock.

A topic whose subscriber makes its publisher wait counts as a call.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet

from poise.model.check.file_paths import connectors
from poise.model.check.ports import Ports
from poise.model.robot import Connector, Robot
from poise.model.yaml.positions import Finding, Path

_Graph = dict[str, list[tuple[Path, Connector]]]


def check_cycles(
    robot: Robot, ports: Ports, reentrant: AbstractSet[str]
) -> Iterator[Finding]:
    """Yield the connectors that close a cycle of calls.

    A call chain excludes other chains from all its components except re-entrant ones.
    So a cycle through a re-entrant component cannot deadlock.

    Parameters
    ----------
    ports
        The known ports; others are not checked.
    reentrant
        Names of the re-entrant components.
    """
    graph = _calls(robot, ports, reentrant)
    done: set[str] = set()
    for start in graph:
        if start not in done:
            yield from _closing(graph, start, done)


def _calls(robot: Robot, ports: Ports, reentrant: AbstractSet[str]) -> _Graph:
    graph: _Graph = {}
    for path, _, connector in connectors(robot):
        source, target = connector.between
        known = [ports.get(end.component, {}).get(end.port) for end in (source, target)]
        waits = any(port is not None and port.waits for port in known)
        ends = {source.component, target.component}
        if waits and reentrant.isdisjoint(ends):
            graph.setdefault(source.component, []).append((path, connector))
    return graph


def _closing(graph: _Graph, start: str, done: set[str]) -> Iterator[Finding]:
    """Yield a finding for every connector back to a component on the way to it."""
    way: list[Connector] = []
    steps = [iter(graph.get(start, ()))]
    names = [start]
    while steps:
        path, connector = next(steps[-1], (None, None))
        if path is None or connector is None:
            done.add(names.pop())
            steps.pop()
            way = way[:-1]
            continue
        callee = connector.between[1].component
        if callee in names:
            cycle = [*way[names.index(callee) :], connector]
            yield Finding(path, _message(cycle))
        elif callee not in done:
            names.append(callee)
            way.append(connector)
            steps.append(iter(graph.get(callee, ())))


def _message(cycle: list[Connector]) -> str:
    closing = cycle[-1]
    callers = [connector.between[0].component for connector in cycle]
    return (
        f"calls form a cycle: {', '.join(map(str, cycle))}. Two calls in it deadlock. "
        f"Make the methods called over {closing} one-way (`@oneway`), or "
        "publish a topic that keeps the last (`subscribed(keep=n)`); or make one of "
        "these components re-entrant (`reentrant = True` in its class): "
        f"{', '.join(callers)}"
    )
