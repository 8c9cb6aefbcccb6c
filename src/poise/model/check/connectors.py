"""Connectors and chains: their components exist and are in the right section."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from poise.model.check.file_paths import component_names, connectors
from poise.model.check.names import check_components_known
from poise.model.robot import Architecture, Connector, Robot
from poise.model.yaml.positions import Finding, Path
from poise.suggest import unknown


def check_connectors(robot: Robot) -> Iterator[Finding]:
    """Yield connectors that are misplaced, duplicate, or join wrong components."""
    names = component_names(robot)
    seen: set[str] = set()
    for path, architecture, connector in connectors(robot):
        for index, end in enumerate(connector.between):
            if end.component not in names:
                message = unknown("component", end.component, names)
                yield Finding((*path, "between", index), message)
        if architecture is not None:
            yield from _foreign_ends(path, architecture, connector, names)
        yield from _same_ends(path, connector)
        if str(connector) in seen:
            yield Finding(path, f"the connector {connector} is defined twice")
        seen.add(str(connector))


def _foreign_ends(
    path: Path, architecture: Architecture, connector: Connector, names: tuple[str, ...]
) -> Iterator[Finding]:
    own = [component.name for component in architecture.components]
    for index, end in enumerate(connector.between):
        if end.component in names and end.component not in own:
            yield Finding(
                (*path, "between", index),
                f"component '{end.component}' is not in architecture "
                f"'{architecture.name}': move this connector to the top-level "
                "`connectors`",
            )


def _same_ends(path: Path, connector: Connector) -> Iterator[Finding]:
    first, second = connector.between
    if first.component == second.component:
        yield Finding(path, f"the connector {connector} joins a component to itself")


def check_chains(robot: Robot) -> Iterator[Finding]:
    """Yield chains through unknown components, or along missing connectors."""
    names = component_names(robot)
    joined = {
        frozenset(end.component for end in connector.between)
        for _, _, connector in connectors(robot)
    }
    for chain in robot.chains:
        path: Path = ("chains", chain.name, "through")
        yield from check_components_known(robot, path, chain.through)
        for index, (one, next_) in enumerate(pairwise(chain.through)):
            known = one in names and next_ in names and one != next_
            if known and frozenset({one, next_}) not in joined:
                yield Finding(
                    (*path, index + 1),
                    f"chain '{chain.name}' goes from '{one}' to '{next_}', but no "
                    "connector joins them",
                )
