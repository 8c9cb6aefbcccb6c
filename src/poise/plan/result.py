"""What a solver answers: a placement that explains itself when it is asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from math import inf
from typing import cast

import msgspec
from msgspec.structs import replace

from poise.errors import UsageError
from poise.plan._core import Core
from poise.plan.conflict import conflict
from poise.plan.problem.arrays import Arrays, Placed, arrays_of
from poise.plan.problem.problem import Problem
from poise.plan.result_records import (
    Ask,
    ComputerTried,
    Conflict,
    GreedyStep,
    PlainResult,
    Selection,
    Shortage,
    Stopped,
    Terms,
    Tightest,
    TimeTaken,
)
from poise.plan.summed_times import seconds
from poise.plan.violations import (
    late,
    loads,
    named,
    obstacle,
    shortages,
    tightest,
    violations,
)

LONGEST_TRACE = 2_000
"""How many trials (components x computers) a trace is worked out for."""

NONE_FOUND = "no placement was found in the time given; there may be one"
IMPOSSIBLE = "no placement keeps all limits"


class Result:
    """A placement, and everything that can be said about it.

    It is light: what is a property here is worked out when it is first asked for. It
    stays as it is when its planner is given other demands.

    Attributes
    ----------
    method
        What found the placement.
    proven
        Whether no placement is better (or, when infeasible, none exists).
    stopped_by
        Why the solver stopped.
    seconds
        How long deciding took [s].
    seed
        Of the search.
    choice
        What was chosen besides the placement.
    compiled, placed
        The problem, compiled, and the computer of each of its units.
    """

    method = "greedy"
    proven = False
    stopped_by: Stopped = "done"
    seed = 0
    choice = Selection()
    _bound: float | None = None
    _conflict: Conflict | None = None
    _given = False

    def __init__(  # a keyword would cost a tenth of a greedy decision
        self,
        compiled: CompiledProblem,
        placed: Placed,
        complete: bool,  # noqa: FBT001
        seconds: float = 0.0,
    ) -> None:
        self.compiled = compiled
        self.placed = placed
        self._complete = complete
        self.seconds = seconds

    @classmethod
    def of(
        cls,
        compiled: CompiledProblem,
        placed: Placed,
        method: str,
        *,
        proven: bool = False,
        stopped_by: Stopped = "done",
        bound: float | None = None,
        given: bool = False,
    ) -> Result:
        """Return a result; `placed` is empty when there is no placement."""
        result = cls(compiled, placed, bool(placed) or not compiled.size)
        result.method = method
        result.proven = proven and compiled.known
        result.stopped_by = stopped_by
        result._bound = bound
        result._given = given
        return result

    def settle(self, bound: float, *, proven: bool) -> None:
        """Say what is known of all choices together, when this is the best of them."""
        self._bound = bound - self.choice.lost
        self.__dict__.pop("bound", None)
        self.proven = proven
        if proven:
            self.stopped_by = "proven" if self.feasible else "infeasible"
        elif self.stopped_by in {"proven", "infeasible"}:
            self.stopped_by = "budget"

    def __repr__(self) -> str:
        """Return what matters most on one line."""
        if self.objective is None:
            return f"<Result: no placement, {self.reason}>"
        return f"<Result: F = {self.objective.total:.6g} by {self.method}>"

    @cached_property
    def placement(self) -> Mapping[str, str]:
        """Component -> computer; empty when none was found."""
        return self.compiled.arrays.placement(self.placed) if self._complete else {}

    @cached_property
    def broken(self) -> Sequence[str]:
        """The limits that a given placement breaks, for people."""
        return violations(self.compiled.arrays, self.placed)

    @property
    def feasible(self) -> bool:
        """Whether it keeps every limit but soft ones."""
        return self._complete and not (self._given and self.broken)

    @property
    def reason(self) -> str:
        """Why it is not feasible, or why architectures were suspended, for people.

        Empty when it is feasible with all of them.
        """
        if self._conflict is not None:
            return _sentence(self._conflict)
        if self._complete and self._given:
            return "; ".join(self.broken) or self.choice.why
        if self._complete:
            return self.choice.why
        if self.method == "greedy" and not self.proven:
            return self.compiled.dead_end()
        return IMPOSSIBLE if self.proven else NONE_FOUND

    @property
    def conflict(self) -> Conflict | None:
        """What cannot hold together where nothing holds, or not all that was suspended.

        None when nothing was missed, or when it is not known. Finding it takes up to a
        second or two.
        """
        return self.find_conflict()

    def find_conflict(self, stop: Ask | None = None) -> Conflict | None:
        """Return `conflict`; `stop` says when to give up looking for it."""
        suspended = self.choice.suspended
        problem = self.choice.whole if suspended or self._complete else self.problem
        if self._conflict is not None or problem is None or self._given:
            return self._conflict
        problems = problem, *self.choice.others
        conflicts = [conflict(part, stop, 1.0 / len(problems)) for part in problems]
        known = [c for c in conflicts if c is not None]
        # of several ways out the cheapest, whichever alternative it is for
        self._conflict = min(
            known, key=lambda way: inf if way.price is None else way.price, default=None
        )
        is_all = bool(self.choice.others) or not self.choice.architectures
        is_proven = is_all and len(known) == len(conflicts)
        if is_proven and not (self._complete or suspended):
            self.proven, self.stopped_by = True, "infeasible"
        return self._conflict

    @cached_property
    def objective(self) -> Terms | None:
        """The terms of F; None without a placement."""
        if not self._complete:
            return None
        return self.compiled.terms(self.placed).with_quality(self.choice.lost)

    @cached_property
    def bound(self) -> float | None:
        """No placement has a lower F than this; None when nothing is known.

        A bound that rounding has put above F is F.
        """
        if self.objective is None or not (self.feasible and self.compiled.known):
            return None
        bound = self._bound
        if bound is None:
            bound = self.compiled.core.bound()
        if bound == -inf:
            return None
        return min(bound + self.choice.lost, self.objective.total)

    @property
    def gap(self) -> float | None:
        """How far F may be above the optimum, as a share of F; None when unknown."""
        if self.objective is None or self.bound is None:
            return None
        if self.proven or self.objective.total <= self.bound:
            return 0.0
        return (self.objective.total - self.bound) / abs(self.objective.total)

    @cached_property
    def tightest(self) -> Tightest | None:
        """The resource closest to its limit; None without a placement."""
        if not self._complete:
            return None
        return tightest(self.compiled.arrays, self.placed)

    @cached_property
    def shortages(self) -> tuple[Shortage, ...]:
        """What computers are short of, where limits are soft; none: they are kept."""
        if not self._complete:
            return ()
        return tuple(shortages(self.compiled.arrays, self.placed))

    @cached_property
    def times(self) -> tuple[TimeTaken, ...]:
        """How long what has a time limit takes."""
        if not (self._complete and self.problem.time_limits):
            return ()
        arrays = self.compiled.arrays
        takes = seconds(arrays, self.placed, loads(arrays, self.placed))
        return tuple(
            TimeTaken(
                name=limit.name, limit=limit.limit, seconds=time, price=limit.price
            )
            for limit, time in zip(self.problem.time_limits, takes, strict=True)
        )

    @cached_property
    def trace(self) -> tuple[GreedyStep, ...]:
        """What the greedy tries, step by step; empty beyond 2,000 trials."""
        if self.compiled.size * len(self.problem.computers) > LONGEST_TRACE:
            return ()
        return self.compiled.greedy_trace()

    @property
    def problem(self) -> Problem:
        """The problem that was decided: with the architectures that were chosen."""
        return self.compiled.problem

    @property
    def unknown(self) -> tuple[str, ...]:
        """Components of which no demand is known."""
        return tuple(c.name for c in self.problem.components if not c.demand)

    @property
    def scale(self) -> str:
        """How F was measured (docs/design/objective.md)."""
        return self.problem.objective.scale

    @property
    def spread(self) -> str:
        """How the spread of residues was measured (docs/design/objective.md)."""
        return self.problem.objective.spread

    @property
    def architectures(self) -> Mapping[str, str]:
        """Function -> the architecture chosen for it, where there was a choice."""
        return self.choice.architectures

    @property
    def suspended(self) -> tuple[str, ...]:
        """Architectures suspended because not all fits."""
        return self.choice.suspended

    def to_dict(self) -> PlainResult:
        """Return all of it as plain values, for JSON; the conflict if it was found."""
        names = [name for name in PlainResult.__annotations__ if name != "conflict"]
        values = {name: getattr(self, name) for name in names}
        return cast(
            "PlainResult", msgspec.to_builtins({**values, "conflict": self._conflict})
        )


def _sentence(conflict: Conflict) -> str:
    names, limits = named(conflict.components), "; ".join(conflict.limits)
    if not limits.startswith(names):
        limits = f"{names} cannot hold together: {limits}"
    return f"{limits}. It would fit with {conflict.relaxation}"


class CompiledProblem:
    """A problem as it was when it was decided, compiled.

    `given` is a placement that may split sets that must share a computer. `core` is
    given where it has other demands than the problem says. Then the problem with these,
    and its arrays, are made when they are asked for.
    """

    def __init__(
        self,
        problem: Problem,
        core: Core | None = None,
        given: Mapping[str, str] | None = None,
    ) -> None:
        self._problem = problem
        self._is_current = core is None
        if core is None:
            self.arrays = arrays_of(problem, given)
            core = Core(self.arrays)
        self.core = core

    def updated(self, demands: dict[str, dict[str, float]]) -> CompiledProblem:
        """Return the same problem with other demands."""
        core = self.core.updated(demands)
        if not self._problem.soft_limits:
            return CompiledProblem(self._problem, core)
        # the core does not know which demands count for which soft limit
        return CompiledProblem(_with_demand(self._problem, core.demand))

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
        """Return F of a placement; units without a computer (-1) contribute nothing."""
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
        """Return each step of the greedy, with every computer that it tries."""
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
        hopeless = (broken.text for broken in late(self.arrays, trial).values())
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
