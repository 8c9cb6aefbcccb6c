"""Where each component may run: somewhere, where it fits at least alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from poise.model.check.file_paths import components
from poise.model.hardware import fits
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot
from poise.model.yaml.positions import Finding, Path
from poise.suggest import listed
from poise.units import format_amount

Names = frozenset[str]


def allowed_computers(robot: Robot, *, layers_stay: bool = True) -> Mapping[str, Names]:
    """Return component -> the computers it may run on; names must be known.

    Parameters
    ----------
    layers_stay
        Whether reactive and deliberative architectures stay at home: only people may
        move them.
    """
    everywhere = frozenset(computer.name for computer in robot.computers)
    return {
        component.name: everywhere.intersection(
            *_limits(robot, architecture, component, layers_stay=layers_stay).values()
        )
        for _, architecture, component in components(robot)
    }


def check_allowed_computers(robot: Robot) -> Iterator[Finding]:
    """Yield the components whose pins, devices and home leave no computer."""
    for path, architecture, component in components(robot):
        limits = _limits(robot, architecture, component)
        if limits and not frozenset.intersection(*limits.values()):
            reasons = "; ".join(f"{r} {listed(sorted(h))}" for r, h in limits.items())
            yield Finding(
                path,
                f"component '{component.name}' cannot run on any computer: {reasons}",
            )


def check_demands(robot: Robot) -> Iterator[Finding]:
    """Yield the demands that are larger than every computer that is allowed.

    Where another architecture of the same function has none, that one can be chosen.
    """
    hosts = allowed_computers(robot)
    found: dict[str, list[Finding]] = {a.name: [] for a in robot.architectures}
    for path, architecture, component in components(robot):
        allowed = [c for c in robot.computers if c.name in hosts[component.name]]
        if allowed:
            found[architecture.name] += _too_large(path, component, allowed)
    can = {a.function for a in robot.architectures if not found[a.name]}
    for architecture in robot.architectures:
        if architecture.function not in can:
            yield from found[architecture.name]


def _too_large(
    path: Path, component: ComponentEntry, allowed: list[Computer]
) -> Iterator[Finding]:
    for resource, amount in component.demand.items():
        largest = max(allowed, key=lambda computer: computer.usable(resource))
        usable = largest.usable(resource)
        if not fits(amount, usable):
            key = () if resource in ("cpu", "memory") else ("resources",)
            yield Finding(
                (*path, *key, resource),
                f"component '{component.name}' needs "
                f"{format_amount(resource, amount)} of {resource}, but the largest "
                f"computer that it may run on, '{largest.name}', has "
                f"{format_amount(resource, usable)} usable (capacity x speed - "
                "reserve)",
            )


def _limits(
    robot: Robot,
    architecture: Architecture,
    component: ComponentEntry,
    *,
    layers_stay: bool = True,
) -> dict[str, Names]:
    """Return what limits a component, for people, -> the computers it leaves.

    Names that are unknown limit nothing: they are problems of their own.
    """
    known = frozenset(computer.name for computer in robot.computers)
    limits = {
        f"device '{device.name}' is on": frozenset({device.computer})
        for device in robot.devices
        if device.name in component.devices
    }
    limits["`only` allows"] = frozenset(component.only)
    is_fixed = layers_stay and architecture.layer != "sequencing"
    if is_fixed and architecture.home is not None:
        reason = f"the {architecture.layer} layer stays at its home"
        limits[reason] = frozenset({architecture.home})
    return {reason: hosts for reason, hosts in limits.items() if hosts & known}
