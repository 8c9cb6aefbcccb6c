"""Ports: the two ends of a connector must fit.

The code declares the ports of its components, the robot file those of components
without a class (`declared_ports`). The same rules check both.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping

from msgspec import Struct

from poise.model.check.file_paths import components, connectors
from poise.model.robot import Connector, ConnectorEnd, PortKind, Robot
from poise.model.yaml.positions import Finding, Path
from poise.suggest import did_you_mean


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
    """Yield the connectors whose ends do not fit, as far as `ports` are known.

    Two ends fit when the first publishes what the second subscribes to, or the first
    requires what the second provides. A required port has one connector, and further
    ones to architectures that take the place of the one that provides it.
    """
    served: dict[str, list[Connector]] = {}
    for path, _, connector in connectors(robot):
        between: Path = (*path, "between")
        found = [_find(end, ports) for end in connector.between]
        for index, end in enumerate(connector.between):
            if end.component in ports and found[index] is None:
                message = no_such_port(end, ports[end.component])
                yield Finding((*between, index), message)
        yield from _misfit(between, connector, found)
        if found[0] is not None and found[0].kind == "requires":
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


def _are_alternatives(robot: Robot, *connectors: Connector) -> bool:
    """Return whether at most one of the connectors' targets runs at a time."""
    home = {c.name: each for each in robot.architectures for c in each.components}
    first, second = (home[each.between[1].component] for each in connectors)
    return first.function == second.function and first.name != second.name


def check_required(robot: Robot, ports: Ports) -> Iterator[Finding]:
    """Yield the required ports that no connector serves."""
    served = {str(connector.between[0]) for _, _, connector in connectors(robot)}
    for path, _, component in components(robot):
        for port in ports.get(component.name, {}).values():
            end = str(ConnectorEnd(component.name, port.name))
            if port.kind == "requires" and end not in served:
                yield Finding(
                    path,
                    f"'{end}' {port}, but no connector joins it to a provider: add "
                    f"`{{between: [{end}, <component>.<port>]}}`",
                )


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
    path: Path, connector: Connector, found: list[KnownPort | None]
) -> Iterator[Finding]:
    first, second = found
    wrong_way = [
        index
        for index, port in enumerate(found)
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
