"""From one placement to another: an ordered, checked plan of steps. Pure.

No computer is overfull at any moment, but in CPU where that is shared: as full as it is
before or after, and fuller midway where nothing else could move.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import inf

from poise.errors import RobotError
from poise.manage.migration.migration_report import TransitionStep
from poise.model.check.allowed_computers import allowed_computers
from poise.model.hardware import fits
from poise.model.robot import Robot
from poise.units import format_amount


def plan_transition(
    robot: Robot,
    now: Mapping[str, str],
    then: Mapping[str, str],
    *,
    shares_cpu: bool = False,
) -> tuple[TransitionStep, ...]:
    """Return the steps between two placements: stops, then moves, then starts."""
    return _Planner(robot, now, then, shares_cpu=shares_cpu).plan()


class _Planner:
    def __init__(
        self,
        robot: Robot,
        now: Mapping[str, str],
        then: Mapping[str, str],
        *,
        shares_cpu: bool,
    ) -> None:
        self._components = {c.name: c for c in robot.components()}
        self._usable = {
            h.name: {r: h.usable(r) for r in h.capacity} for h in robot.computers
        }
        self._robot = robot
        self._now = dict(now)
        self._then = then
        self._steps: list[TransitionStep] = []
        self._cpu_is_in_the_way = shares_cpu
        if shares_cpu:
            for loads in (self._loads(self._now), self._loads(self._then)):
                self._raise_cpu({h: load.get("cpu", 0.0) for h, load in loads.items()})
        self._check(then)

    def _raise_cpu(self, loads: Mapping[str, float]) -> None:
        """Let computers be this full."""
        for computer, load in loads.items():
            usable = self._usable[computer]
            usable["cpu"] = max(usable.get("cpu", 0.0), load)

    def plan(self) -> tuple[TransitionStep, ...]:
        for name in sorted(self._now.keys() - self._then.keys()):
            self._stop(name)
        stopped = self._move_all()
        for name in sorted(self._then.keys() - self._now.keys()):
            why = "second half of a cold move" if name in stopped else ""
            self._start(name, why)
        return tuple(self._steps)

    def _check(self, then: Mapping[str, str]) -> None:
        loads = self._loads(then)
        for computer, usable in self._usable.items():
            for resource, used in loads[computer].items():
                if not fits(used, usable.get(resource, 0.0)):
                    raise RobotError(
                        f"computer '{computer}' would be overfull: "
                        f"{format_amount(resource, used)} of {resource} wanted, "
                        f"{format_amount(resource, usable.get(resource, 0.0))} usable"
                    )
        for name in sorted(self._now.keys() & then.keys()):
            if self._now[name] != then[name] and not self._components[name].movable:
                raise RobotError(
                    f"component '{name}' is not movable, but would go from "
                    f"'{self._now[name]}' to '{then[name]}'"
                )

    def _move_all(self) -> set[str]:
        """Move all that is elsewhere; return what had to be stopped instead."""
        stopped: set[str] = set()
        intermediate: set[str] = set()
        while pending := self._pending():
            ready = (n for n in pending if self._fits(n, self._then[n]))
            if (name := next(ready, None)) is not None:
                self._move(name, self._then[name])
                continue
            if self._cpu_is_in_the_way:
                self._cpu_is_in_the_way = False
                self._raise_cpu(dict.fromkeys(self._usable, inf))
                continue
            if (move := self._intermediate_move(pending, intermediate)) is not None:
                intermediate.add(move[0])
                self._move(*move, why="an intermediate move: there is no room yet")
                continue
            name = pending[0]
            why = "a cold move: no computer has room for an intermediate move"
            self._stop(name, why)
            stopped.add(name)
        return stopped

    def _pending(self) -> list[str]:
        """Return what must still move: the least state first, then what helps most."""

        def rank(name: str) -> tuple[float, float, str]:
            component = self._components[name]
            return component.state, -component.demand.get("cpu", 0.0), name

        away = (n for n, h in self._now.items() if self._then.get(n, h) != h)
        return sorted(away, key=rank)

    def _intermediate_move(
        self, pending: Iterable[str], done: set[str]
    ) -> tuple[str, str] | None:
        allowed = allowed_computers(self._robot)
        for name in pending:
            for computer in sorted(allowed[name] - {self._now[name]}):
                if name not in done and self._fits(name, computer):
                    return name, computer
        return None

    def _fits(self, name: str, computer: str) -> bool:
        load = self._loads(self._now)[computer]
        usable = self._usable[computer]
        return all(
            fits(load.get(resource, 0.0) + amount, usable.get(resource, 0.0))
            for resource, amount in self._components[name].demand.items()
        )

    def _loads(self, placement: Mapping[str, str]) -> dict[str, dict[str, float]]:
        loads: dict[str, dict[str, float]] = {name: {} for name in self._usable}
        for name, computer in placement.items():
            load = loads[computer]
            for resource, amount in self._components[name].demand.items():
                load[resource] = load.get(resource, 0.0) + amount
        return loads

    def _move(self, name: str, target: str, why: str = "") -> None:
        source = self._now[name]
        self._now[name] = target
        self._steps.append(TransitionStep(name, source, target, why))

    def _stop(self, name: str, why: str = "") -> None:
        source = self._now.pop(name)
        self._steps.append(TransitionStep(name, source, why=why))

    def _start(self, name: str, why: str) -> None:
        self._steps.append(TransitionStep(name, target=self._then[name], why=why))


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


def missing_cpu(
    robot: Robot, placement: Mapping[str, str], demands: Mapping[str, float] = {}
) -> dict[str, float]:
    """Return computer -> CPU that its components need and it does not have [cores].

    `demands`: component -> what it needs, if that is not what the robot says.
    """
    left = {c.name: c.usable("cpu") for c in robot.computers}
    for component in robot.components():
        computer = placement.get(component.name)
        if computer in left:
            usual = component.demand.get("cpu", 0.0)
            left[computer] -= demands.get(component.name, usual)
    return {name: max(0.0, -cpu) for name, cpu in left.items()}
