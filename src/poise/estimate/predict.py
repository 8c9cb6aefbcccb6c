"""What each computer will use under a placement, and what connectors cost apart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from poise.estimate.profile import ConnectorProfile, Costs, Profile
from poise.model.robot import Robot

Placement = Mapping[str, str]


def predicted_cpu(
    robot: Robot, placement: Placement, profile: Profile
) -> dict[str, float]:
    """Return what each computer is expected to use [cores of the reference computer].

    The means of its components and their parts of their containers, its agent, and half
    the cost of every connector whose other end is elsewhere.

    Parameters
    ----------
    placement
        Component -> computer; components that the profile does not know count nothing.
    """
    used = {computer.name: profile.agent for computer in robot.computers}
    for component, computer in placement.items():
        known = profile.components.get(component)
        if known is not None:
            used[computer] += known.cpu.mean + known.share
    remote = profile.costs.get("remote", Costs())
    for source, target, traffic in _apart(robot, placement, profile):
        for computer in (source, target):
            used[computer] += remote.load(traffic) / 2
    return used


def overheads(profile: Profile) -> dict[str, float]:
    """Return the relative overhead of each connector (the paper's matrix).

    What it would cost both computers if its ends were apart, in hundredths of a core.
    Without measured costs: its traffic [MB/s].
    """
    remote = profile.costs.get("remote")
    return {
        name: each.traffic / 1e6 if remote is None else 100 * remote.load(each)
        for name, each in profile.connectors.items()
    }


def _apart(
    robot: Robot, placement: Placement, profile: Profile
) -> Iterator[tuple[str, str, ConnectorProfile]]:
    for connector in robot.all_connectors():
        ends = [placement.get(end.component) for end in connector.between]
        traffic = profile.connectors.get(str(connector))
        if traffic and ends[0] and ends[1] and ends[0] != ends[1]:
            yield ends[0], ends[1], traffic
