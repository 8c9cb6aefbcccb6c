"""From a profile to the demands that the planner reads.

The rule: a component demands what it needs over two seconds in 95 of 100 cases, plus
its part of its container, plus a twentieth; of memory the most that it ever held, plus
its part of its container, plus a tenth. What the robot file says itself always wins: a
person may know more than a measurement.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import msgspec

from poise.estimate.profile import ComponentProfile, ConnectorProfile, Profile
from poise.estimate.running import Estimate
from poise.model.robot import Component, Connector, Robot

CPU_HEADROOM = 0.05
MEMORY_HEADROOM = 0.10


def cpu_demand(profile: ComponentProfile) -> float:
    """Return the CPU that the planner should count with [cores]."""
    return (profile.cpu.sustained + profile.share) * (1 + CPU_HEADROOM)


def memory_demand(profile: ComponentProfile) -> float:
    """Return the memory that the planner should count with [bytes]."""
    return (profile.memory + profile.base) * (1 + MEMORY_HEADROOM)


def shifted_cpu_demand(
    demand: float, expected: float | None, estimate: Estimate
) -> float:
    """Return the CPU to count with, now that a component needs other than it did.

    Parameters
    ----------
    demand
        What was counted with so far [cores].
    expected
        Mean CPU by the profile that `demand` is from [cores]; the demand then shifts
        by the same ratio as the mean. None, or 0: there is none; the estimate and its
        error are then counted with, plus the headroom.
    """
    if expected:
        return demand * estimate.mean / expected
    return (estimate.mean + (estimate.error or 0.0)) * (1 + CPU_HEADROOM)


def with_profile(robot: Robot, profile: Profile) -> Robot:
    """Return `robot` with the demands and traffic that its file leaves open."""
    return msgspec.structs.replace(
        robot,
        architectures=tuple(
            msgspec.structs.replace(
                architecture,
                components=tuple(
                    _component(c, profile.components.get(c.name))
                    for c in architecture.components
                ),
                connectors=_connectors(architecture.connectors, profile.connectors),
            )
            for architecture in robot.architectures
        ),
        connectors=_connectors(robot.connectors, profile.connectors),
    )


def missing(robot: Robot, profile: Profile) -> list[str]:
    """Return the components whose demand neither the file nor the profile gives."""
    return [
        component.name
        for component in robot.components()
        if {"cpu", "memory"} - component.demand.keys()
        and component.name not in profile.components
    ]


def _component(component: Component, profile: ComponentProfile | None) -> Component:
    if profile is None:
        return component
    measured = {"cpu": cpu_demand(profile), "memory": memory_demand(profile)}
    return msgspec.structs.replace(
        component,
        demand={**measured, **component.demand},
        state=component.state or profile.state,
    )


def _connectors(
    connectors: Iterable[Connector], profiles: Mapping[str, ConnectorProfile]
) -> tuple[Connector, ...]:
    return tuple(_connector(each, profiles.get(str(each))) for each in connectors)


def _connector(connector: Connector, profile: ConnectorProfile | None) -> Connector:
    if profile is None or connector.overhead is not None:
        return connector
    return msgspec.structs.replace(
        connector,
        message=connector.message or profile.size,
        rate=connector.rate or profile.rate,
    )
