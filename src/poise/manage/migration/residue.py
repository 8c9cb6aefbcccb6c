"""What a placement leaves of each computer. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from poise.model.robot import Robot


def residue(robot: Robot, placement: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """Return computer -> resource -> how much of it is left; less than 0: it is short.

    Components that are placed on other computers than the robot's do not count.
    """
    left = {c.name: {r: c.usable(r) for r in c.capacity} for c in robot.computers}
    for component in robot.components():
        here = left.get(placement.get(component.name, ""), {})
        for resource, amount in component.demand.items():
            here[resource] = here.get(resource, 0.0) - amount
    return left


def missing_cpu(robot: Robot, placement: Mapping[str, str]) -> dict[str, float]:
    """Return computer -> CPU that its components need and it does not have [cores]."""
    left = {c.name: c.usable("cpu") for c in robot.computers}
    for component in robot.components():
        computer = placement.get(component.name)
        if computer in left:
            left[computer] -= component.demand.get("cpu", 0.0)
    return {name: max(0.0, -cpu) for name, cpu in left.items()}
