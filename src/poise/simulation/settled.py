"""Whether a simulated robot is as it should be."""

from __future__ import annotations

from poise.simulation.robot.robot import SimulatedRobot


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
