"""Turns a profile into the demands that the planner reads.

CPU demand is the 95th percentile over two seconds plus its part of the container, plus
5 %. Memory demand is the peak plus its part of the container, plus 10 %. Values in the
robot file win over measured ones, but for a state, a message or a rate of 0.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from poise.estimate.online import Estimate
from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    KindCosts,
    Profile,
)
from poise.model.robot import ComponentEntry, Connector, Robot

_HUNDREDTHS = 100
_MEGABYTE = 1e6


def overhead_of(
    connector: ConnectorProfile, together: str, costs: Mapping[str, KindCosts]
) -> float:
    """Return the relative overhead of a connector, >= 0; `costs` is by its kind."""
    if "remote" not in costs:
        return connector.traffic / _MEGABYTE
    less = costs.get(together, KindCosts()).load(connector)
    return _HUNDREDTHS * max(0.0, costs["remote"].load(connector) - less)


def overheads(robot: Robot, profile: Profile) -> dict[str, float]:
    """Return the relative overhead of each measured connector."""
    kinds = kinds_together(robot)
    return {
        name: overhead_of(connector, kinds[name], profile.costs)
        for name, connector in profile.connectors.items()
        if name in kinds
    }


def kinds_together(robot: Robot) -> dict[str, str]:
    """Return connector -> its kind when both ends are on one computer.

    The components of one architecture share a container, unless one is isolated or a
    command.
    """
    kinds = {str(connector): "local" for connector in robot.connectors}
    for architecture in robot.architectures:
        components = architecture.components
        alone = {c.name for c in components if c.isolated or c.command}
        for connector in architecture.connectors:
            ends = {end.component for end in connector.between}
            kinds[str(connector)] = "local" if ends & alone else "direct"
    return kinds


def declared(connector: Connector) -> ConnectorProfile:
    """Return the traffic in the robot file, which does not distinguish calls."""
    return ConnectorProfile(messages=connector.rate, size=connector.message)


CPU_HEADROOM = 0.05
MEMORY_HEADROOM = 0.10


def cpu_demand(profile: ComponentProfile) -> float:
    """Return the CPU demand for the planner [cores]."""
    return (profile.cpu.sustained + profile.share) * (1 + CPU_HEADROOM)


def memory_demand(profile: ComponentProfile) -> float:
    """Return the memory demand for the planner [bytes]."""
    return (profile.memory + profile.base) * (1 + MEMORY_HEADROOM)


def shifted_cpu_demand(
    demand: float, expected: float | None, estimate: Estimate
) -> float:
    """Return the CPU demand after a drift [cores], in proportion to the mean.

    Of a demand of 0 there is no proportion: then the measured mean counts.
    """
    if expected and demand:
        return demand * estimate.mean / expected
    return (estimate.mean + (estimate.error or 0.0)) * (1 + CPU_HEADROOM)


def with_profile(robot: Robot, profile: Profile) -> Robot:
    """Return `robot` with measured demands and traffic where its file has none."""
    kinds = kinds_together(robot)
    robot = robot.with_connectors(lambda c: _connector(c, profile, kinds[str(c)]))
    known = profile.components
    architectures = []
    for architecture in robot.architectures:
        components = [_component(c, known.get(c.name)) for c in architecture.components]
        architectures.append(replace(architecture, components=tuple(components)))
    return replace(robot, architectures=tuple(architectures))


def missing(robot: Robot, profile: Profile) -> list[str]:
    """Return the components whose demand neither the file nor the profile gives."""
    return [
        component.name
        for component in robot.components()
        if {"cpu", "memory"} - component.demand.keys()
        and component.name not in profile.components
    ]


def _component(
    component: ComponentEntry, profile: ComponentProfile | None
) -> ComponentEntry:
    if profile is None:
        return component
    measured = {"cpu": cpu_demand(profile), "memory": memory_demand(profile)}
    return replace(
        component,
        demand={**measured, **component.demand},
        state=component.state or profile.state,
    )


def _connector(connector: Connector, profile: Profile, kind: str) -> Connector:
    """Return a connector with its traffic, and its overhead if costs were measured."""
    known = profile.connectors.get(str(connector), ConnectorProfile())
    rate, message = connector.rate or known.rate, connector.message or known.size
    filled = replace(connector, message=message, rate=rate)
    if connector.overhead is not None or not profile.costs:
        return filled
    used = declared(filled)
    if (rate, message) == (known.rate, known.size):
        used = known
    overhead = overhead_of(used, kind, profile.costs)
    return replace(filled, overhead=overhead)
