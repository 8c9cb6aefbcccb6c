"""Faults at the worst moments: amid a move, and as soon as a manager is up."""

from __future__ import annotations

from collections.abc import Callable

from poise.simulation.faults import Kind, SimulatedFault
from poise.simulation.robot.simulated_robot import SimulatedRobot

_KINDS: tuple[Kind, ...] = (
    "kill manager",
    "pause manager",
    "kill container",
    "pause container",
    "kill agent",
    "pause agent",
    "pause computer",
    "cut link",
    "isolate computer",
    "take over",
)
_IN_RUNS = 0.5
_OFTEN = {"steps": 0.05, "up": 0.3}
"""How often one follows on steps of a migration that a container gets, and on a manager
that is up."""
_WITHIN = {"steps": 0.02, "up": 0.3}
"""It follows within this time [s]."""
_LONGEST = 8.0


class AimedFaults:
    """Breaks something when something else begins, in about half of all runs.

    `end`: all are over before this moment [s].
    `inject`: lets a fault begin now.
    `faults`: those so far.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        end: float,
        inject: Callable[[SimulatedFault], object],
    ) -> None:
        self.faults: list[SimulatedFault] = []
        self._robot = robot
        self._end = end
        self._inject = inject
        if robot.choices.happens("faults", _IN_RUNS):
            robot.on_moment = self._note

    def _note(self, moment: str, computer: str) -> None:
        choices, scheduler = self._robot.choices, self._robot.scheduler
        if not choices.happens("faults", _OFTEN[moment]):
            return
        kind = _KINDS[choices.among("faults", len(_KINDS))]
        if moment == "up":
            kind = "kill manager"
        at = scheduler.now + choices.between("faults", 0.0, _WITHIN[moment])
        lasts = _LONGEST * choices.draw("faults") ** 2
        others = [name for name in self._robot.computers if name != computer]
        other = others[choices.among("faults", len(others))]
        fault = SimulatedFault(
            at=at,
            kind=kind,
            target=computer if computer in self._robot.computers else other,
            other=other if kind == "cut link" else "",
            lasts=lasts,
            pick=choices.draw("faults"),
        )
        if at + lasts < self._end:
            self.faults.append(fault)
            scheduler.at(at, lambda: self._inject(fault))
