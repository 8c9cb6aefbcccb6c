"""A problem as it was when it was decided, and what can be worked out from it."""

from __future__ import annotations

from functools import cached_property

from msgspec.structs import replace

from poise.errors import UsageError
from poise.plan._core import Core
from poise.plan.problem.arrays import Arrays, Placed, arrays_of
from poise.plan.problem.problem import Problem
from poise.plan.result_records import ComputerTried, GreedyStep, Terms
from poise.plan.why.violations import late, obstacle


class Snapshot:
    """A problem as it was when it was decided, compiled.

    `core` is given where it has other demands than the problem says. Then the problem
    with these, and its arrays, are made when they are asked for.
    """

    def __init__(self, problem: Problem, core: Core | None = None) -> None:
        self._problem = problem
        self._is_current = core is None
        if core is None:
            self.arrays = arrays_of(problem)
            core = Core(self.arrays)
        self.core = core

    def updated(self, demands: dict[str, dict[str, float]]) -> Snapshot:
        """Return the same problem with other demands."""
        core = self.core.updated(demands)
        if not self._problem.soft_limits:
            return Snapshot(self._problem, core)
        # the core does not know which demands count for which soft limit
        return Snapshot(_with_demand(self._problem, core.demand))

    @property
    def size(self) -> int:
        """How many components there are."""
        return len(self._problem.components)

    @property
    def problem(self) -> Problem:
        """The problem, with its present demands."""
        if not self._is_current:
            self._problem = _with_demand(self._problem, self.core.demand)
            self._is_current = True
        return self._problem

    @cached_property
    def known(self) -> bool:
        """Whether the demand of any component is known."""
        components = self._problem.components
        return not (self._is_current and components) or any(
            c.demand for c in components
        )

    @cached_property
    def arrays(self) -> Arrays:
        """The problem in numbers."""
        return arrays_of(self.problem)

    @cached_property
    def present(self) -> Placed:
        """Where all components run now, or nothing when some component has no place."""
        components = self._problem.components
        if any(c.present is None for c in components):
            return []
        try:
            now = {c.name: c.present for c in components if c.present is not None}
            return self.arrays.placed(now)
        except UsageError:  # what must share a computer does not
            return []

    def terms(self, placed: Placed) -> Terms:
        """Return F of a placement; units without a computer (-1) contribute nothing.

        But to how long something takes they contribute what they take at least.
        """
        communication, balance, move, shortage, time = self.core.terms(placed)
        return Terms(
            total=communication + balance + move + shortage + time,
            communication=communication,
            balance=balance,
            move=move,
            shortage=shortage,
            time=time,
        )

    def greedy_trace(self) -> tuple[GreedyStep, ...]:
        """Return each step of the greedy, with every computer that it tries.

        The last one has no `chosen` when the greedy came to a dead end.
        """
        decided, _ = self.core.greedy()
        placed = [-1] * self.arrays.n
        trace: list[GreedyStep] = []
        for unit in self.core.order:
            trials = tuple(self._trial(placed, unit, h) for h in range(self.arrays.m))
            placed[unit] = decided[unit]
            is_dead_end = decided[unit] < 0
            chosen = None if is_dead_end else self.arrays.computer(decided[unit])
            name = self.arrays.name(unit)
            trace.append(GreedyStep(component=name, trials=trials, chosen=chosen))
            if is_dead_end:
                break
        return tuple(trace)

    def _trial(self, placed: Placed, unit: int, computer: int) -> ComputerTried:
        trial = [*placed[:unit], computer, *placed[unit + 1 :]]
        # no limit of time may be broken already, whatever breaks it
        hopeless = (each.text for each in late(self.arrays, trial).values())
        reason = obstacle(self.arrays, placed, unit, computer) or "; ".join(hopeless)
        total = None if reason else self.terms(trial).total
        return ComputerTried(
            computer=self.arrays.computer(computer), total=total, reason=reason
        )

    def dead_end(self) -> str:
        """Return where the greedy comes to a dead end, and why."""
        last = self.greedy_trace()[-1]
        why = "; ".join(trial.reason for trial in last.trials)
        return f"the greedy finds no computer for {last.component} ({why})"


def _with_demand(problem: Problem, demand: list[float]) -> Problem:
    resources = problem.resources
    if not resources:
        return problem
    rows = zip(
        *[iter(demand)] * (len(resources) + len(problem.soft_limits)), strict=True
    )
    return replace(
        problem,
        components=tuple(
            replace(c, demand=dict(zip(resources, row, strict=False)))
            for c, row in zip(problem.components, rows, strict=True)
        ),
    )
