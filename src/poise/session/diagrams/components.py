"""The component diagram of a robot: architectures, interfaces and flows of messages."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from poise.model.robot import Connector, ConnectorEnd, Robot
from poise.runtime.component.implementation import find, search_also
from poise.runtime.component.ports import ports_of
from poise.session.diagrams.records import ComponentDiagram, Join, Subsystem

Ports = dict[str, dict[str, tuple[str, str]]]
"""Component -> port -> its kind and the name of its type."""


def component_diagram(
    robot: Robot, functions: Collection[str] | None
) -> ComponentDiagram:
    """Return the diagram of what provides `functions`; None: of all architectures."""
    chosen = [
        each
        for each in robot.architectures
        if functions is None or each.function in functions
    ]
    drawn = {c.name for each in chosen for c in each.components}
    subsystems = tuple(
        Subsystem(each.name, each.function, tuple(c.name for c in each.components))
        for each in chosen
    )
    ports = _ports(robot, drawn)
    joins = dict.fromkeys(
        _join(connector, ports)
        for connector in robot.all_connectors()
        if {end.component for end in connector.between} <= drawn
    )
    return ComponentDiagram(robot.name, subsystems, tuple(joins))


def _join(connector: Connector, ports: Ports) -> Join:
    source, target = connector.between
    kind, type_ = _port(source, ports) or _port(target, ports) or ("", "")
    names = source.component, target.component
    if kind in {"requires", "provides"}:
        return Join(*names, "call", target.port, type_)
    return Join(*names, "flow" if kind else "use", source.port, type_)


def _port(end: ConnectorEnd, ports: Ports) -> tuple[str, str] | None:
    return ports[end.component].get(end.port)


def _ports(robot: Robot, drawn: Collection[str]) -> Ports:
    search_also(robot.repository)
    ports: Ports = {}
    for component in robot.components():
        if component.name in drawn:
            declared = {
                each.name: (each.kind, each.type.rpartition(":")[2])
                for each in component.ports
            }
            named = dict(_of_class(component.implementation, robot.folder))
            ports[component.name] = declared | named
    return ports


def _of_class(
    implementation: str, folder: str
) -> Iterator[tuple[str, tuple[str, str]]]:
    if implementation:
        for name, port in ports_of(find(implementation, folder)).items():
            yield name, (port.kind, getattr(port.type, "__qualname__", str(port.type)))
