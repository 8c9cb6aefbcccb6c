"""What of the next actions is prepared, within what those that run leave free. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from msgspec import Struct

from poise.manage.migration.residue import residue
from poise.manage.tasks.likely import Likely
from poise.model.hardware import fits
from poise.model.robot import ComponentEntry, Robot
from poise.units import format_amount

LEAST_CPU = 0.01
"""Nothing begins to be prepared where less CPU is left for it [cores]."""


class PrefetchPlan(Struct, frozen=True, kw_only=True):
    """What is to be prepared.

    Parameters
    ----------
    placement
        Component -> computer; what the likeliest action needs comes first.
    why_not
        Action and task -> why nothing is prepared for it.
    """

    placement: Mapping[str, str]
    why_not: Mapping[tuple[str, str], str]


def choose(
    robot: Robot,
    running: Mapping[str, str],
    likely: Iterable[Likely],
    *,
    cpu: Mapping[str, float],
    held: Mapping[str, str],
) -> PrefetchPlan:
    """Return what is to be prepared, the likeliest action first: all of it, or nothing.

    An action for which there is no room is left out, and a less likely one that fits is
    not. What runs already, or uses an exclusive device that is in use, is prepared for
    none.

    Parameters
    ----------
    running
        Component -> computer, of what is at work.
    cpu
        Computer -> CPU that may be used to prepare [cores]; one that is not named is
        out of reach.
    held
        Component -> computer, of what is prepared already: it needs no CPU. What of it
        no action needs stays while there is room.
    """
    components = {component.name: component for component in robot.components()}
    left = residue(robot, running)
    for amounts in left.values():
        amounts["memory"] = robot.prefetch.memory * amounts.get("memory", 0.0)
    in_use = _exclusive_devices(robot, running, components)
    placement: dict[str, str] = {}
    why_not: dict[tuple[str, str], str] = {}
    rest = [_resting(n, computer) for n, computer in held.items()]
    for each in [*sorted(likely, key=lambda each: -each.probability), *rest]:
        wanted = {
            name: computer
            for name, computer in each.placement.items()
            if name not in running
            and name not in placement
            and in_use.isdisjoint(components[name].devices)
        }
        new = {computer for n, computer in wanted.items() if held.get(n) != computer}
        why = _without_cpu(new, cpu) or _without_room(wanted, left, components)
        if why:
            why_not[each.action, each.task] = why
            continue
        for name, computer in wanted.items():
            for resource, amount in _held_by(components[name]):
                left[computer][resource] -= amount
        placement |= wanted
    return PrefetchPlan(placement=placement, why_not=why_not)


def _resting(component: str, computer: str) -> Likely:
    return Likely(
        task="", action=component, placement={component: computer}, probability=0.0
    )


def _held_by(component: ComponentEntry) -> Iterable[tuple[str, float]]:
    """Return what a component holds that is configured, and does not work."""
    return [(r, amount) for r, amount in component.demand.items() if r != "cpu"]


def _exclusive_devices(
    robot: Robot, running: Iterable[str], components: Mapping[str, ComponentEntry]
) -> set[str]:
    """Return the devices that only one may use, and one does."""
    used = {device for name in running for device in components[name].devices}
    return used & {device.name for device in robot.devices if device.exclusive}


def _without_cpu(computers: Collection[str], cpu: Mapping[str, float]) -> str:
    for name in sorted(computers):
        if name not in cpu:
            return f"computer '{name}' is out of reach"
        if cpu[name] < LEAST_CPU:
            return f"what runs leaves no CPU of computer '{name}'"
    return ""


def _without_room(
    wanted: Mapping[str, str],
    left: Mapping[str, Mapping[str, float]],
    components: Mapping[str, ComponentEntry],
) -> str:
    needed: dict[tuple[str, str], float] = {}
    for name, computer in wanted.items():
        for resource, amount in _held_by(components[name]):
            key = computer, resource
            needed[key] = needed.get(key, 0.0) + amount
    for (computer, resource), amount in needed.items():
        room = left[computer].get(resource, 0.0)
        if not fits(amount, room):
            return (
                f"it needs {format_amount(resource, amount)} of {resource} on "
                f"'{computer}', where {format_amount(resource, max(0.0, room))} may be "
                "used for it"
            )
    return ""
