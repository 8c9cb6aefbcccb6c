"""Addresses: they are well formed and unique, and all computers have one or none."""

from __future__ import annotations

from collections.abc import Iterator

from poise.endpoint import Endpoint
from poise.model.robot import Robot
from poise.model.yaml.positions import Finding
from poise.suggest import listed


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
