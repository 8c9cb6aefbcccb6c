"""Connectors and chains: their components exist and are in the right section.

The code declares the ports of its components, the robot file those of components
without a class (`declared_ports`). The same rules check both.

A topic whose subscriber makes its publisher wait counts as a call.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from itertools import pairwise

from msgspec import Struct

from poise.errors import did_you_mean
from poise.model.check.names import component_names, components, connectors
from poise.model.check.ros2_components import bridge_of
from poise.model.robot import Connector, ConnectorEnd, PortKind, Robot
from poise.model.yaml_tree import Finding, Path


def check_connectors(robot: Robot) -> Iterator[Finding]:
    """Yield connectors that are misplaced, duplicate, or join a component to itself."""
    owners: dict[str, set[str]] = {}
    for _, owner, component in components(robot):
        owners.setdefault(component.name, set()).add(owner.name)
    seen: set[str] = set()
    for path, architecture, connector in connectors(robot):
        for index, end in enumerate(connector.between):
            own = owners.get(end.component)  # None: it is unknown
            if architecture is not None and own and architecture.name not in own:
                yield Finding(
                    (*path, "between", index),
                    f"component '{end.component}' is not in architecture "
                    f"'{architecture.name}': move this connector to the top-level "
                    "`connectors`",
                )
        first, second = connector.between
        if first.component == second.component:
            text = f"the connector {connector} joins a component to itself"
            yield Finding(path, text)
        if str(connector) in seen:
            yield Finding(path, f"the connector {connector} is defined twice")
        seen.add(str(connector))


def check_chains(robot: Robot) -> Iterator[Finding]:
    """Yield chains along missing connectors."""
    names = component_names(robot).keys()
    joined = {
        frozenset(end.component for end in connector.between)
        for _, _, connector in connectors(robot)
    }
    # one end is misspelt, which is a problem already: it may be the one that is missed
    half = {name for pair in joined if not pair <= names for name in pair}
    for chain in robot.chains:
        path: Path = ("chains", chain.name, "through")
        for index, (one, next_) in enumerate(pairwise(chain.through)):
            pair = frozenset({one, next_})
            known = pair <= names and one != next_
            if known and pair not in joined and half.isdisjoint(pair):
                yield Finding(
                    (*path, index + 1),
                    f"chain '{chain.name}' goes from '{one}' to '{next_}', but no "
                    "connector joins them",
                )


class KnownPort(Struct, frozen=True):
    """A port whose kind and type are known.

    `type` is for people; two ports fit when their `meaning` is equal. `waits`: callers
    wait there for answers, or publishers for space in its queue.
    """

    name: str
    kind: PortKind
    type: str
    meaning: Hashable
    waits: bool = False

    def __str__(self) -> str:
        return f"{self.kind} {self.type}"


Ports = Mapping[str, Mapping[str, KnownPort]]
"""Component -> its ports by name. A component that is missing may have any port."""

OPPOSITE: Mapping[PortKind, PortKind] = {
    "publishes": "subscribes",
    "requires": "provides",
    "subscribes": "publishes",
    "provides": "requires",
}
_FIRST = ("publishes", "requires")


def declared_ports(robot: Robot) -> Ports:
    """Return the ports of the components that declare theirs in the robot file."""
    return {
        component.name: {
            port.name: KnownPort(port.name, port.kind, port.type, port.type)
            for port in component.ports
        }
        for component in robot.components()
        if component.ports
    }


def check_ports(robot: Robot, ports: Ports) -> Iterator[Finding]:
    """Yield the connectors whose ends do not fit, as far as `ports` are known."""
    served: dict[str, list[Connector]] = {}
    for path, _, connector in connectors(robot):
        if connector.topic:
            continue  # ROS 2 joins them
        between: Path = (*path, "between")
        joined = [_find(end, ports) for end in connector.between]
        for index, end in enumerate(connector.between):
            if end.component in ports and joined[index] is None:
                message = no_such_port(end, ports[end.component])
                yield Finding((*between, index), message)
        yield from _misfit(between, connector, joined)
        if joined[0] is not None and joined[0].kind == "requires":
            caller = str(connector.between[0])
            for other in served.setdefault(caller, []):
                if not _are_alternatives(robot, connector, other):
                    yield Finding(
                        (*between, 0),
                        f"'{caller}' requires one provider, but has two connectors: "
                        f"{other} and {connector}; only architectures that provide "
                        "the same function may both be joined to it",
                    )
                    break
            served[caller].append(connector)
    yield from _backwards(robot, ports)


def _backwards(robot: Robot, ports: Ports) -> Iterator[Finding]:
    """Yield the steps of chains that lead from a subscriber to its publisher only."""
    ways: set[tuple[str, str]] = set()
    for _, _, connector in connectors(robot):
        source, target = (end.component for end in connector.between)
        first = _find(connector.between[0], ports)
        ways.add((source, target))
        if first is None or first.kind != "publishes":
            ways.add((target, source))  # with answers
    for chain in robot.chains:
        for index, (one, next_) in enumerate(pairwise(chain.through)):
            if (next_, one) in ways and (one, next_) not in ways:
                yield Finding(
                    ("chains", chain.name, "through", index + 1),
                    f"chain '{chain.name}' goes from '{one}' to '{next_}', but "
                    f"messages go from '{next_}' to '{one}' only",
                )


def _are_alternatives(robot: Robot, *connectors: Connector) -> bool:
    """Return whether at most one of the connectors' targets runs at a time."""
    home = {c.name: a for a in robot.architectures for c in a.components}
    first, second = (home[connector.between[1].component] for connector in connectors)
    return first.function == second.function and first.name != second.name


def check_unconnected(robot: Robot, ports: Ports) -> Iterator[Finding]:
    """Yield the required ports and subscriptions that no connector joins."""
    joined = {
        str(end) for _, _, connector in connectors(robot) for end in connector.between
    }
    for bridge in robot.ros2.bridges:  # connected when the code is known
        joined |= {str(bridge.port), f"{bridge_of(bridge.port)}.{bridge.port.port}"}
    if robot.workload is not None:  # these get messages while they are measured
        joined |= {str(generated.port) for generated in robot.workload.generate}
    for path, _, component in components(robot):
        for port in ports.get(component.name, {}).values():
            end = str(ConnectorEnd(component.name, port.name))
            if end in joined or port.kind not in _UNCONNECTED:
                continue
            what, between = _UNCONNECTED[port.kind]
            yield Finding(
                path,
                f"'{end}' {port}, but no connector joins it to {what}: add "
                f"`{{between: [{between.format(end)}]}}`",
            )


_UNCONNECTED: Mapping[PortKind, tuple[str, str]] = {
    "requires": ("a provider", "{}, <component>.<port>"),
    "subscribes": ("a publisher", "<component>.<port>, {}"),
}
"""Ports that are of no use alone: what they need, and the connector that brings it."""


def _find(end: ConnectorEnd, ports: Ports) -> KnownPort | None:
    return ports.get(end.component, {}).get(end.port)


def no_such_port(end: ConnectorEnd, ports: Mapping[str, KnownPort]) -> str:
    """Return the message for an end that is none of a component's ports."""
    choices = ", ".join(f"'{port.name}' ({port})" for port in ports.values()) or "none"
    if not end.port:
        return f"name the port of component '{end.component}' too; it has: {choices}"
    return (
        f"component '{end.component}' has no port '{end.port}'"
        f"{did_you_mean(end.port, ports)}; ports: {choices}"
    )


def _misfit(
    path: Path, connector: Connector, ports: list[KnownPort | None]
) -> Iterator[Finding]:
    first, second = ports
    wrong_way = [
        index
        for index, port in enumerate(ports)
        if port is not None and (port.kind in _FIRST) != (index == 0)
    ]
    if first and second and OPPOSITE[first.kind] != second.kind:
        yield Finding(
            path,
            f"'{connector.between[0]}' {first.kind} and '{connector.between[1]}' "
            f"{second.kind}: that does not fit; a connector joins "
            "publishes -> subscribes or requires -> provides",
        )
    elif wrong_way:
        yield Finding(
            path,
            f"the connector {connector} is the wrong way round: the publisher or "
            f"caller comes first, as in [{connector.between[1]}, "
            f"{connector.between[0]}]",
        )
    elif first and second and first.meaning != second.meaning:
        yield Finding(
            path,
            f"the types differ: '{connector.between[0]}' {first}, "
            f"'{connector.between[1]}' {second}",
        )


_Graph = dict[str, list[tuple[Path, Connector]]]


def check_cycles(
    robot: Robot, ports: Ports, reentrant: AbstractSet[str]
) -> Iterator[Finding]:
    """Yield the connectors that close a cycle of calls.

    A call chain excludes other chains from all its components except re-entrant ones.
    So a cycle through a re-entrant component cannot deadlock.
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
        known = [_find(end, ports) for end in connector.between]
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
