"""Names: each used name exists, and no name is defined twice."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from poise.endpoint import Endpoint
from poise.errors import listed, unknown
from poise.model.robot import Architecture, ComponentEntry, Connector, Robot
from poise.model.yaml_tree import Finding, Path


def check_addresses(robot: Robot) -> Iterator[Finding]:
    """Yield addresses that are malformed, shared or missing."""
    owners: dict[Endpoint, str] = {}
    for computer in robot.computers:
        if computer.address is None:
            continue
        path = ("computers", computer.name, "address")
        try:
            endpoint = Endpoint.parse(computer.address)
        except ValueError as error:
            yield Finding(path, f"computer '{computer.name}': {error}")
            continue
        owner = owners.setdefault(endpoint, computer.name)
        if owner != computer.name:
            yield Finding(
                path,
                f"computers '{owner}' and '{computer.name}' have the same address "
                f"{endpoint}; each agent needs its own host or port",
            )
    yield from _missing(robot)


def _missing(robot: Robot) -> Iterator[Finding]:
    reachable = [c.name for c in robot.computers if c.address is not None]
    for computer in robot.computers if reachable else ():
        if computer.address is None:
            yield Finding(
                ("computers", computer.name),
                f"computer '{computer.name}' has no address, but others have one "
                f"({listed(reachable)}); give all computers an address, or none of "
                "them to emulate all",
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


def component_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of all components."""
    return tuple(component.name for component in robot.components())


def check_names(robot: Robot) -> Iterator[Finding]:
    """Yield the unknown and the duplicate names of a robot."""
    yield from _duplicate_components(robot)
    yield from _devices(robot)
    yield from _links(robot)
    yield from _architectures(robot)
    yield from _never_chosen(robot)
    yield from _components(robot)
    yield from _resources(robot)


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


def _devices(robot: Robot) -> Iterator[Finding]:
    for device in robot.devices:
        path = ("devices", device.name, "computer")
        yield from _known(path, "computer", device.computer, _computers(robot))


def _links(robot: Robot) -> Iterator[Finding]:
    first: dict[frozenset[str], int] = {}
    for index, link in enumerate(robot.links):
        path = ("links", index, "between")
        yield from each_known(path, "computer", link.between, _computers(robot))
        ends = frozenset(link.between)
        if len(ends) == 1:
            yield Finding(path, f"a link joins '{link.between[0]}' to itself")
        elif ends in first:
            names = " and ".join(f"'{end}'" for end in link.between)
            yield Finding(path, f"there are two links between {names}")
        first.setdefault(ends, index)


def _architectures(robot: Robot) -> Iterator[Finding]:
    for architecture in robot.architectures:
        path: Path = ("architectures", architecture.name)
        if architecture.home is not None:
            home = (*path, "home")
            yield from _known(home, "computer", architecture.home, _computers(robot))
        elif architecture.layer != "sequencing":
            yield Finding(
                path,
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


def _components(robot: Robot) -> Iterator[Finding]:
    devices = [device.name for device in robot.devices]
    for path, _, component in components(robot):
        yield from each_known((*path, "devices"), "device", component.devices, devices)
        yield from each_known(
            (*path, "only"), "computer", component.only, _computers(robot)
        )
        yield from _one_way_to_run(path, component)


def _one_way_to_run(path: Path, component: ComponentEntry) -> Iterator[Finding]:
    if component.implementation and component.command:
        yield Finding(
            (*path, "command"),
            f"component '{component.name}' has an implementation and a command; "
            "remove one of them",
        )
    if component.implementation and component.ports:
        yield Finding(
            (*path, "ports"),
            f"component '{component.name}' has an implementation: its class declares "
            "its ports, so leave `ports` out",
        )


def _resources(robot: Robot) -> Iterator[Finding]:
    known = dict.fromkeys(r for c in robot.computers for r in c.capacity)
    path: Path
    for section in ("weights", "sizes"):
        for resource in getattr(robot.objective, section):
            path = ("objective", section, resource)
            yield from _known(path, "resource", resource, known)
    for computer in robot.computers:
        for resource in computer.reserve:
            path = ("computers", computer.name, "reserve", resource)
            yield from _known(path, "resource", resource, computer.capacity)


def _computers(robot: Robot) -> list[str]:
    return [computer.name for computer in robot.computers]


def each_known(
    path: Path, kind: str, names: Iterable[str], choices: Iterable[str]
) -> Iterator[Finding]:
    """Yield a finding at its own index for every unknown or duplicate name."""
    choices, seen = tuple(choices), set()
    for index, name in enumerate(names):
        yield from _known((*path, index), kind, name, choices)
        # A link from a computer to itself has a message of its own.
        if name in seen and path[0] != "links":
            yield Finding((*path, index), f"the {kind} '{name}' is listed twice")
        seen.add(name)


def _known(
    path: Path, kind: str, name: str, choices: Collection[str]
) -> Iterator[Finding]:
    if name not in choices:
        yield Finding(path, unknown(kind, name, choices))


def check_components_known(
    robot: Robot, path: Path, names: Iterable[str]
) -> Iterator[Finding]:
    """Yield a finding for every name that is no component, or is listed twice."""
    yield from each_known(path, "component", names, component_names(robot))
