"""Faults at the worst moments: amid a move, as a manager is up, and as one hangs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct

from poise.simulation.faults import SimulatedFault, SimulatedFaultKind
from poise.simulation.robot.modelled_container import Moment
from poise.simulation.robot.simulated_robot import SimulatedRobot


class _Aim(Struct, frozen=True):
    """What may follow on a moment, in which share of them, and how soon [s]."""

    kinds: tuple[SimulatedFaultKind, ...]
    often: float
    within: float


_AIMS: Mapping[Moment, _Aim] = {
    "steps": _Aim(
        (
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
        ),
        often=0.05,
        within=0.02,
    ),
    # where a client wants something to be
    "command": _Aim(
        ("kill agent", "pause agent", "pause computer", "isolate computer"),
        often=0.1,
        within=0.5,
    ),
    "up": _Aim(("kill manager", "pause manager"), often=0.3, within=0.3),
    # somebody sees that it does not answer
    "paused": _Aim(("take over", "another manager"), often=0.5, within=3.0),
}
_IN_RUNS = 0.5
_AGAIN = 0.3
"""How often one more follows on the same moment."""
_LONGEST = 8.0


class AimedFaults:
    """Breaks something when something else begins, in about half of all runs.

    `begin`, `end`: nothing breaks before, and all is over after [s].
    `inject`: lets a fault begin now.
    `kinds`: which may.
    `faults`: those so far.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        begin: float,
        end: float,
        inject: Callable[[SimulatedFault], object],
        kinds: Sequence[SimulatedFaultKind],
    ) -> None:
        self.faults: list[SimulatedFault] = []
        self._robot = robot
        self._begin, self._end = begin, end
        self._inject = inject
        self._kinds = kinds
        if robot.choices.happens("faults", _IN_RUNS):
            robot.on_moment = self._note

    def _note(self, moment: Moment, computer: str) -> None:
        if self._robot.scheduler.now < self._begin:
            return
        aim = _AIMS[moment]
        often, choices = aim.often, self._robot.choices
        while choices.happens("faults", often):
            self._plan(aim, computer)
            computer = [*self._robot.computers][
                choices.among("faults", len(self._robot.computers))
            ]
            often = _AGAIN

    def _plan(self, aim: _Aim, computer: str) -> None:
        choices, scheduler = self._robot.choices, self._robot.scheduler
        kind = aim.kinds[choices.among("faults", len(aim.kinds))]
        at = scheduler.now + choices.between("faults", 0.0, aim.within)
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
        if at + lasts < self._end and kind in self._kinds:
            self.faults.append(fault)
            scheduler.at(at, lambda: self._inject(fault))
