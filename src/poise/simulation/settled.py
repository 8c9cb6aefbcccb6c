"""Whether a simulated robot is as it should be."""

from __future__ import annotations

from poise.manage.control_socket.commands import RobotStatus
from poise.simulation.robot.robot import SimulatedRobot

_ANSWERED = 0.01
"""A manager answers within this time [s]."""


def unsettled(robot: SimulatedRobot) -> list[str]:
    """Return what is not as it is desired, in words."""
    manager = robot.manager
    if manager is None or manager.manager is None or manager.run is None:
        why = robot.managers[-1].error if robot.managers else None
        return [f"no manager is up ({why or 'it starts'})"]
    working: dict[str, list[str]] = {}
    for container in robot.containers():
        if container.process.is_paused:
            continue
        for component in container.components.values():
            if component.is_working():
                at = container.process.computer.name
                working.setdefault(component.spec.name, []).append(at)
    found = [
        f"'{name}' works on {' and '.join(working.get(name, ['nothing']))}, not '{at}'"
        for name, at in sorted(manager.run.placement().items())
        if working.get(name) != [at]
    ]
    lost = sorted(manager.manager.lost())
    return found + [f"the manager takes '{name}' for lost" for name in lost]


def not_well(robot: SimulatedRobot) -> list[str]:
    """Return what is not as it is desired, or is said not to be."""
    found, manager = unsettled(robot), robot.manager
    if found or manager is None:
        return found
    said: list[str] = []
    is_told: list[RobotStatus] = []

    def take(status: RobotStatus) -> None:
        is_told.append(status)
        # a clock that jumped is said for a while, and so are many restarts
        said.extend(
            f"status says: {each.what}"
            for each in status.deviations
            if each.computer and not each.what.startswith("container '")
        )

    manager.ask_status(take)
    robot.run(robot.scheduler.now + _ANSWERED)
    return said if is_told else ["the manager does not say how it is"]
