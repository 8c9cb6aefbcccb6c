"""`Planner`, built once and used often; which solver when: greedy, proof, or search."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, log2
from time import perf_counter, thread_time
from typing import Literal, NamedTuple, cast, get_args

from msgspec.structs import replace

from poise.errors import UsageError, unknown
from poise.plan._core import Core
from poise.plan.alternatives import admit, chosen_by, has_choice, without
from poise.plan.conflict import is_hopeless
from poise.plan.problem.arrays import Placed
from poise.plan.problem.changed_problem import keep_components, scale_of, share_cpu
from poise.plan.problem.items import Item
from poise.plan.problem.problem import Problem
from poise.plan.result import CompiledProblem, Result
from poise.plan.result_records import Answer, Ask, Stopped

LONGEST = 1e9
"""A budget beyond this is as good as none [s]."""
BUDGET = 0.1
"""How long to decide by default [s]."""
Overload = Literal["refuse", "share"]
"""What is done where CPU is short: nothing fits, or it is shared (`share_cpu`)."""


class Planner:
    """Decides where components run, again and again, as demands and pins change.

    Building it takes some 50 microseconds for a small robot; then a decision by the
    greedy takes one or two, and a proven optimum a dozen. One thread at a time may use
    it; while a solver searches, other threads run.

    Examples
    --------
    >>> planner = Planner(problem_of(load("robot.yaml")))
    >>> planner.decide().placement
    {'camera': 'head', 'planner': 'main'}
    >>> planner.update({"planner": {"cpu": 1.5}})
    >>> planner.place("camera", "main")
    >>> planner.decide("greedy").objective
    """

    def __init__(self, problem: Problem) -> None:
        self._held: dict[str, Item] = {}  # by `place`, as they were before
        self._has_alternatives = has_choice(problem)
        self._keep(CompiledProblem(problem))

    def _keep(self, compiled: CompiledProblem) -> None:
        self._parts: dict[frozenset[str], Planner] = {}
        self._sharing: Planner | None = None
        self._compiled = compiled
        self._greedy = compiled.core.greedy

    @property
    def problem(self) -> Problem:
        """The problem as it is now, with the demands and pins that were given."""
        return self._compiled.problem

    def decide(
        self,
        method: str = "auto",
        budget: float = BUDGET,
        seed: int = 0,
        *,
        steps: int | None = None,
        fewer: bool = False,
        overload: Overload = "refuse",
        stop: Ask | None = None,
    ) -> Result:
        """Return the best placement found within `budget` [s].

        Ctrl-C in the main thread ends the search, and the best placement so far is
        returned.

        Parameters
        ----------
        method
            ``auto``: greedy, then proof and search as the budget allows; ``greedy``:
            the paper's; ``exact``: branch and bound until proven or out of budget;
            ``search``: the anytime search.
        budget
            CPU time to decide [s], finite, >= 0; on a busy machine that takes longer, 4
            times at most. The greedy always runs to its end.
        seed
            Of the search, >= 0.
        steps
            Limit of search moves or nodes instead of the budget: then the same seed
            gives the same placement.
        fewer
            Suspend architectures, lowest priority first, when not all fits.
        overload
            ``share``: CPU may be short; the placement has the least shortage, counted
            by priority, and of such placements the least F. `Result.shortages` says
            where.
        stop
            Asked up to 100 times a second, in any thread, whether to return the best
            placement so far, such as ``threading.Event().is_set``. What it raises is
            raised.

        Raises
        ------
        UsageError
            When the budget, method, seed, steps or overload are not ones.
        """
        start = perf_counter()
        if overload != "refuse":
            sharing = self._for_overload(overload)
            return sharing.decide(
                method, budget, seed, steps=steps, fewer=fewer, stop=stop
            )
        if method == "greedy" and not (fewer or self._has_alternatives):
            placed, complete = self._greedy()
            return Result(self._compiled, placed, complete, perf_counter() - start)
        _check_call(budget, method, seed, steps, stop)
        effort = Effort(min(budget, LONGEST), steps, seed, stop)
        if fewer or self._has_alternatives:
            result = admit(
                self.problem,
                lambda names, share: self._decide_part(
                    names, method, effort.share(share)
                ),
                fewer=fewer,
            )
        else:
            result = run_portfolio(self._compiled, method, effort)
        result.seconds = perf_counter() - start
        result.seed = seed
        return result

    def _for_overload(self, overload: Overload) -> Planner:
        if overload not in get_args(Overload):
            choices = " or ".join(get_args(Overload))
            raise UsageError(f"overload is {overload!r}, must be {choices}")
        if self._sharing is None:
            self._sharing = Planner(share_cpu(self.problem))
        return self._sharing

    def _decide_part(
        self, components: frozenset[str], method: str, effort: Effort
    ) -> Result:
        """Return the placement of some components, without a choice among them."""
        part = self._parts.get(components)
        if part is None:
            arrays = self._compiled.arrays
            part = Planner(keep_components(self.problem, components, arrays=arrays))
            self._parts[components] = part
        return run_portfolio(part._compiled, method, effort)

    def update(self, demands: dict[str, dict[str, float]]) -> None:
        """Change what components need, from the next decision on.

        Parameters
        ----------
        demands
            Component -> resource -> amount, >= 0; what is not named keeps its demand.

        Raises
        ------
        UsageError
            When a component or resource is not there, or an amount is not one; then
            nothing has changed.
        """
        try:
            self._keep(self._compiled.updated(demands))
        except (TypeError, ValueError, RuntimeError) as error:
            raise UsageError(f"update: {error}") from None

    def place(self, component: str, computer: str) -> None:
        """Hold a component to a computer, from the next decision on.

        Raises
        ------
        UsageError
            When there is no such component or computer, or it may not run there.
        """
        items = {c.name: c for c in self.problem.components}
        if component not in items:
            raise UsageError(unknown("component", component, items))
        free = self._held.get(component, items[component])
        choices = free.only or tuple(h.name for h in self.problem.computers)
        if computer not in choices:
            why = f" ({free.why})" if free.why else ""
            raise UsageError(
                f"{component!r} cannot be placed on {computer!r}: it may run on "
                f"{', '.join(choices)}{why}"
            )
        self._hold(component, (computer,), f"placed on {computer}")
        self._held[component] = free

    def release(self, component: str) -> None:
        """Let a component that `place` holds run again where it may.

        Raises
        ------
        UsageError
            When it is not held.
        """
        free = self._held.pop(component, None)
        if free is None:
            raise UsageError(f"{component!r} is not held to a computer by `place`")
        self._hold(component, free.only, free.why)

    def _hold(self, component: str, only: tuple[str, ...], why: str) -> None:
        components = tuple(
            replace(c, only=only, why=why) if c.name == component else c
            for c in self.problem.components
        )
        # what is held together counts on, so that F can be compared
        scale = scale_of(self.problem, self._compiled.arrays)
        problem = replace(self.problem, components=components, overhead_scale=scale)
        self._keep(CompiledProblem(problem))


def _check_call(
    budget: float, method: str, seed: int, steps: int | None, stop: Ask | None
) -> None:
    given: object = budget
    if not (isinstance(given, float | int) and 0 <= given < inf):
        raise UsageError(f"budget is {budget!r} s, must be finite and >= 0")
    if method not in SOLVERS:
        raise UsageError(f"no method {method!r} (there are: {', '.join(SOLVERS)})")
    counts: dict[str, object] = {"seed": seed, "steps": 0 if steps is None else steps}
    for name, count in counts.items():
        if not (isinstance(count, int) and 0 <= count < UNLIMITED):
            raise UsageError(
                f"{name} is {count!r}, must be a whole number in [0, 2^62)"
            )
    if not (stop is None or callable(stop)):
        raise UsageError(f"stop is {stop!r}, must be a function or None")


def solve(  # noqa: PLR0913 - each says how to decide, and has a default
    problem: Problem,
    budget: float = BUDGET,
    method: str = "auto",
    seed: int = 0,
    *,
    steps: int | None = None,
    fewer: bool = False,
    overload: Overload = "refuse",
    stop: Ask | None = None,
    why: bool = True,
) -> Result:
    """Return the best placement found within `budget` [s]: a `Planner` used once.

    Parameters and errors are those of `Planner.decide`, besides:

    Parameters
    ----------
    why
        Look at once for what cannot hold together where nothing holds, or not all that
        was suspended; that takes up to a second or two on top of the budget.
    """
    start = perf_counter()
    planner = Planner(problem)
    result = planner.decide(
        method, budget, seed, steps=steps, fewer=fewer, overload=overload, stop=stop
    )
    if why and method != "greedy":
        result.find_conflict(stop)
    result.seconds = perf_counter() - start
    return result


def evaluate(
    problem: Problem,
    placement: Mapping[str, str],
    method: str = "given",
    *,
    suspended: tuple[str, ...] = (),
    why: str = "",
) -> Result:
    """Return what can be said of a given placement, feasible or not.

    Of alternatives, the placement holds exactly one, and none of what is suspended.

    Parameters
    ----------
    placement
        Component -> computer.
    method
        What decided it, for people.
    suspended
        Architectures that do not run, as a result names them.
    why
        Why they do not, for people.

    Raises
    ------
    UsageError
        When a component has no computer, or one that is not there.
    """
    runs = without(problem, suspended) if suspended else problem
    choice, part = chosen_by(runs, placement)
    compiled = CompiledProblem(part, given=placement)
    placed = compiled.arrays.placed(placement)
    result = Result.of(compiled, placed, method, given=True)
    if suspended:
        choice = choice._replace(suspended=suspended, why=why)
    result.choice = choice
    return result


BUSY = 4.0
"""On a busy machine a budget lasts this many times as long at most; `Stop` of the core
(`plan/core/stop.h`) has the same number."""


class Budget:
    """What this thread may spend from now on [s of a CPU]."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._began, self._cpu = perf_counter(), thread_time()

    def left(self) -> float:
        """Return what is left [s]; below 0 when it is over."""
        waited = (perf_counter() - self._began) / BUSY
        return self._seconds - max(thread_time() - self._cpu, waited)


SOLVERS = ("auto", "greedy", "exact", "search")

UNLIMITED = 1 << 62
"""A number of steps that no solver reaches."""
GLANCE = 0.1
"""Which part of the effort a first proof may take: often it is enough."""
MOST_PLACEMENTS = 100
"""Up to 2 to the power of this many placements (50 components on 4 computers) a second
proof has a chance. On two computers it is the frontier that counts."""
LOOK_AROUND = 0.15
"""Which part of the effort goes into a first search, so that a second proof starts
well."""
PROOF = 0.5
"""Which part of the effort may go into a second proof."""


class Effort(NamedTuple):
    """How long to decide: `seconds` of CPU time, or `steps` to be reproducible."""

    seconds: float
    steps: int | None
    seed: int = 0
    stop: Ask | None = None

    def share(self, part: float) -> Effort:
        """Return a part, in (0, 1], of the effort."""
        steps = None if self.steps is None else int(self.steps * part)
        return Effort(self.seconds * part, steps, self.seed, self.stop)

    def is_none(self) -> bool:
        """Whether there is no time for anything but the greedy."""
        return self.seconds <= 0 if self.steps is None else self.steps == 0

    def exact(self, core: Core, known: Placed) -> Answer:
        """Spend it on a proof."""
        return Answer(*core.exact(known, *self._limits(), self.stop))

    def search(self, core: Core, known: Placed) -> Answer:
        """Spend it on search."""
        return Answer(*core.search(known, *self._limits(), self.seed, self.stop))

    def _limits(self) -> tuple[float, int]:
        return (self.seconds, UNLIMITED) if self.steps is None else (inf, self.steps)


def run_portfolio(compiled: CompiledProblem, method: str, effort: Effort) -> Result:
    """Decide a problem in which every component is needed."""
    core = compiled.core
    known, name = _start(compiled, method)
    if method == "greedy" or (effort.is_none() and method == "auto"):
        return Result.of(compiled, known, name)
    if method == "exact":
        if not core.provable:
            raise UsageError(
                f"{compiled.size} components on {len(compiled.problem.computers)} "
                "computers are too many for 'exact' (at most 1024 on 64); take 'search'"
            )
        answer, finder = effort.exact(core, known), "exact"
    elif method == "search":
        answer, finder = effort.search(core, known), "search"
    else:
        answer, finder = _auto(compiled, known, effort)
    if answer.proven or answer.placed != known:
        name = finder
    return _described(compiled, name, answer)


def _described(compiled: CompiledProblem, method: str, answer: Answer) -> Result:
    proven, stopped_by = answer.proven, answer.stopped_by
    is_none = not answer.placed and compiled.size > 0
    if is_none and (proven or is_hopeless(compiled.arrays)):
        proven, stopped_by = True, "infeasible"
    return Result.of(
        compiled,
        answer.placed,
        method,
        proven=proven,
        stopped_by=cast("Stopped", stopped_by),
        bound=max(answer.bound, compiled.core.bound()),
    )


def _start(compiled: CompiledProblem, method: str) -> tuple[Placed, str]:
    """Return the placement to start from: as it is now, or the greedy's, or none."""
    core = compiled.core
    greedy, complete = core.greedy()
    # it subtracts in another order: what is just within a limit may be beyond it here
    placed: Placed = greedy if complete and core.feasible(greedy) else []
    present: Placed = [] if method == "greedy" else compiled.present
    if not (present and core.feasible(present)):
        return placed, "greedy"
    if placed and sum(core.terms(placed)) < sum(core.terms(present)):
        return placed, "greedy"
    return present, "present"


def _may_be_proven(compiled: CompiledProblem) -> bool:
    n, m = compiled.size, len(compiled.problem.computers)
    return m == 2 or n * log2(m) <= MOST_PLACEMENTS  # noqa: PLR2004 - a tree of its own


def _auto(
    compiled: CompiledProblem, known: Placed, effort: Effort
) -> tuple[Answer, str]:
    """Try to prove at once; search a little, try to prove again, and search on."""
    core = compiled.core
    if not core.provable:
        return effort.search(core, known), "search"
    budget = Budget(effort.seconds)
    before, used = effort.share(GLANCE).exact(core, known), GLANCE
    if before.proven or before.stopped_by == "interrupted":
        return before, "exact"
    # A search in two parts finds less than one: only for a proof it is worth it.
    if _may_be_proven(compiled):
        first = effort.share(LOOK_AROUND).search(core, before.placed)
        if first.stopped_by == "interrupted":
            return first, "search"
        before = effort.share(PROOF).exact(core, first.placed)
        used += LOOK_AROUND + PROOF
        if before.proven or before.stopped_by == "interrupted":
            return before, "exact"
    left = max(0.0, budget.left())
    rest = Effort(left, effort.share(1 - used).steps, effort.seed + 1, effort.stop)
    last = rest.search(core, before.placed)
    return last._replace(bound=max(last.bound, before.bound)), "search"
