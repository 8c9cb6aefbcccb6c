"""Names: each used name exists, and no name is defined or listed twice."""

from __future__ import annotations

from collections.abc import Iterator

from poise.endpoint import Endpoint
from poise.errors import listed, unknown
from poise.model.robot import Architecture, ComponentEntry, Connector, Robot
from poise.model.yaml_tree import Finding, Path


def check_addresses(robot: Robot) -> Iterator[Finding]:
    """Yield addresses that are malformed, shared or missing."""
    owners: dict[Endpoint, str] = {}
    reachable = [c.name for c in robot.computers if c.address is not None]
    for computer in robot.computers if reachable else ():
        name = computer.name
        if computer.address is None:
            yield Finding(
                ("computers", name),
                f"computer '{name}' has no address, but others have one "
                f"({listed(reachable)}); give all computers an address, or none of "
                "them to emulate all",
            )
            continue
        path = ("computers", name, "address")
        try:
            endpoint = Endpoint.parse(computer.address)
        except ValueError as error:
            yield Finding(path, f"computer '{name}': {error}")
            continue
        owner = owners.setdefault(endpoint, name)
        if owner != name:
            yield Finding(
                path,
                f"computers '{owner}' and '{name}' have the same address "
                f"{endpoint}; each agent needs its own host or port",
            )


def components(robot: Robot) -> Iterator[tuple[Path, Architecture, ComponentEntry]]:
    """Yield every component with its path and its architecture."""
    for architecture in robot.architectures:
        for component in architecture.components:
            path = ("architectures", architecture.name, "components", component.name)
            yield path, architecture, component


def connectors(robot: Robot) -> Iterator[tuple[Path, Architecture | None, Connector]]:
    """Yield every connector with its path and its architecture, if it is in one."""
    for architecture in robot.architectures:
        for index, connector in enumerate(architecture.connectors):
            path = ("architectures", architecture.name, "connectors", index)
            yield path, architecture, connector
    for index, connector in enumerate(robot.connectors):
        yield ("connectors", index), None, connector


def component_names(robot: Robot) -> dict[str, None]:
    """Return the names of all components, in order."""
    return dict.fromkeys(component.name for component in robot.components())


def check_names(robot: Robot) -> Iterator[Finding]:
    """Yield the unknown and the duplicate names of a robot."""
    choices = {
        "architecture": [architecture.name for architecture in robot.architectures],
        "component": component_names(robot),
        "computer": [computer.name for computer in robot.computers],
        "device": [device.name for device in robot.devices],
        "resource": dict.fromkeys(r for c in robot.computers for r in c.capacity),
    }
    for path, kind, name in mentions(robot):
        if name not in choices[kind]:
            yield Finding(path, unknown(kind, name, choices[kind]))
    for path, kind, names in _sets(robot):
        for index, name in enumerate(names):
            if name in names[:index]:
                yield Finding((*path, index), f"the {kind} '{name}' is listed twice")
    yield from _duplicate_components(robot)
    yield from _links(robot)
    yield from _architectures(robot)
    yield from _never_chosen(robot)
    yield from _one_way_to_run(robot)
    yield from _reserves(robot)


def mentions(robot: Robot) -> Iterator[tuple[Path, str, str]]:
    """Yield each place in the file that names something: its path, a kind, the name.

    Those in tasks are not among them.
    """
    yield from _single_names(robot)
    for path, kind, names in _sets(robot):
        for index, name in enumerate(names):
            yield (*path, index), kind, name
    for index, link in enumerate(robot.links):
        for end, computer in enumerate(link.between):
            yield ("links", index, "between", end), "computer", computer
    for path, _, connector in connectors(robot):
        for index, port in enumerate(connector.between):
            yield (*path, "between", index), "component", port.component
    for index, bridge in enumerate(robot.ros2.bridges):
        yield ("ros2", "bridges", index, "port"), "component", bridge.port.component
    for generated in robot.workload.generate if robot.workload else ():
        port = generated.port
        yield ("workload", "generate", str(port)), "component", port.component


def _single_names(robot: Robot) -> Iterator[tuple[Path, str, str]]:
    for device in robot.devices:
        yield ("devices", device.name, "computer"), "computer", device.computer
    for architecture in robot.architectures:
        if architecture.home is not None:
            path = ("architectures", architecture.name, "home")
            yield path, "computer", architecture.home
    for section in ("weights", "sizes"):
        for resource in getattr(robot.objective, section):
            yield ("objective", section, resource), "resource", resource
    for policy in robot.policies:
        for key, kind in (("to", "computer"), ("by", "architecture")):
            if (name := getattr(policy, key)) is not None:
                yield ("policies", policy.name, key), kind, name


def _sets(robot: Robot) -> Iterator[tuple[Path, str, tuple[str, ...]]]:
    """Yield each list of the file in which nothing may be twice."""
    yield ("manager",), "computer", robot.manager or ()
    yield ("keeps",), "device", robot.keeps
    for path, _, component in components(robot):
        yield (*path, "devices"), "device", component.devices
        yield (*path, "only"), "computer", component.only
    for chain in robot.chains:
        yield ("chains", chain.name, "through"), "component", chain.through
    for index, names in enumerate(robot.together):
        yield ("together", index), "component", names
    for index, names in enumerate(robot.apart):
        yield ("apart", index), "component", names


def _duplicate_components(robot: Robot) -> Iterator[Finding]:
    first: dict[str, str] = {}
    for path, architecture, component in components(robot):
        if component.name in first:
            yield Finding(
                path,
                f"there is a component '{component.name}' in architecture "
                f"'{first[component.name]}' already; component names are robot-wide",
            )
        first.setdefault(component.name, architecture.name)


def _links(robot: Robot) -> Iterator[Finding]:
    seen: set[frozenset[str]] = set()
    for index, link in enumerate(robot.links):
        path = ("links", index, "between")
        ends = frozenset(link.between)
        if len(ends) == 1:
            yield Finding(path, f"a link joins '{link.between[0]}' to itself")
        elif ends in seen:
            names = " and ".join(f"'{end}'" for end in link.between)
            yield Finding(path, f"there are two links between {names}")
        seen.add(ends)


def _architectures(robot: Robot) -> Iterator[Finding]:
    for architecture in robot.architectures:
        if architecture.home is None and architecture.layer != "sequencing":
            yield Finding(
                ("architectures", architecture.name),
                f"architecture '{architecture.name}' is in the {architecture.layer} "
                "layer, which does not move: it needs a `home` computer",
            )


def _never_chosen(robot: Robot) -> Iterator[Finding]:
    """Yield the architectures beside one that does not move and so always runs."""
    fixed: dict[str, Architecture] = {}
    for architecture in robot.architectures:
        if architecture.layer != "sequencing":
            fixed.setdefault(architecture.function, architecture)
    for architecture in robot.architectures:
        runs = fixed.get(architecture.function, architecture)
        if runs.name != architecture.name:
            yield Finding(
                ("architectures", architecture.name, "function"),
                f"architecture '{architecture.name}' would never run: '{runs.name}' of "
                f"the {runs.layer} layer provides '{runs.function}', too, and Poise "
                "chooses only in the sequencing layer. Remove one of them, or name "
                "another function",
            )


def _one_way_to_run(robot: Robot) -> Iterator[Finding]:
    for path, _, component in components(robot):
        if component.implementation and component.command:
            yield Finding(
                (*path, "command"),
                f"component '{component.name}' has an implementation and a command; "
                "remove one of them",
            )
        if component.implementation and component.ports:
            yield Finding(
                (*path, "ports"),
                f"component '{component.name}' has an implementation: its class "
                "declares its ports, so leave `ports` out",
            )


def _reserves(robot: Robot) -> Iterator[Finding]:
    for computer in robot.computers:
        for resource in computer.reserve:
            if resource not in computer.capacity:
                path = ("computers", computer.name, "reserve", resource)
                yield Finding(path, unknown("resource", resource, computer.capacity))
