"""Demands: each component fits on some computer, at least alone."""

from __future__ import annotations

from collections.abc import Iterator

from poise.model.check.allowed_computers import allowed_computers
from poise.model.check.file_paths import components
from poise.model.robot import ComponentEntry, Computer, Robot
from poise.model.yaml.positions import Finding, Path
from poise.units import format_amount

SLACK = 1e-9
"""Rounding: a demand may exceed a capacity by this share of it."""


def check_demands(robot: Robot) -> Iterator[Finding]:
    """Yield the demands that are larger than every computer that is allowed."""
    hosts = allowed_computers(robot)
    for path, _, component in components(robot):
        allowed = [c for c in robot.computers if c.name in hosts[component.name]]
        if allowed:
            yield from _too_large(path, component, allowed)


def _too_large(
    path: Path, component: ComponentEntry, allowed: list[Computer]
) -> Iterator[Finding]:
    for resource, amount in component.demand.items():
        largest = max(allowed, key=lambda computer: computer.usable(resource))
        usable = largest.usable(resource)
        if amount > usable * (1 + SLACK):
            key = () if resource in ("cpu", "memory") else ("resources",)
            yield Finding(
                (*path, *key, resource),
                f"component '{component.name}' needs "
                f"{format_amount(resource, amount)} of {resource}, but the largest "
                f"computer that it may run on, '{largest.name}', has "
                f"{format_amount(resource, usable)} usable (capacity x speed - "
                "reserve)",
            )
