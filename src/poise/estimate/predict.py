"""Predicts the CPU of each computer under a placement."""

from __future__ import annotations

from collections.abc import Mapping

from poise.estimate.overhead import apart, kinds_together, overhead_of
from poise.estimate.profile import Profile
from poise.model.robot import Robot

Placement = Mapping[str, str]


def predicted_cpu(
    robot: Robot, placement: Placement, profile: Profile
) -> dict[str, float]:
    """Return the predicted CPU of each computer [cores of the reference computer].

    It is the sum of its components' means, their parts of containers, its agent, and
    the additional CPU of connectors to other computers.

    Parameters
    ----------
    placement
        Component -> computer; components without a profile count as 0.
    """
    used = {computer.name: profile.agent for computer in robot.computers}
    for component, computer in placement.items():
        known = profile.components.get(component)
        if known is not None:
            used[computer] += known.cpu.mean + known.share
    kinds = kinds_together(robot)
    for connector in robot.all_connectors():
        source, target = (placement.get(end.component) for end in connector.between)
        traffic = profile.connectors.get(str(connector))
        if traffic and source and target and source != target:
            more = apart(traffic, kinds[str(connector)], profile.costs)
            used[source] += more.source
            used[target] += more.target
    return used


def overheads(robot: Robot, profile: Profile) -> dict[str, float]:
    """Return the relative overhead of each measured connector."""
    kinds = kinds_together(robot)
    return {
        name: overhead_of(each, kinds[name], profile.costs)
        for name, each in profile.connectors.items()
        if name in kinds
    }
