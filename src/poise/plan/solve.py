"""`solve`: the one function that decides a placement."""

from __future__ import annotations

from math import inf
from time import perf_counter

from msgspec.structs import replace

from poise.errors import UsageError
from poise.plan.admission import admit, alternatives, part_of
from poise.plan.check import check
from poise.plan.engine import UNLIMITED, Ask
from poise.plan.greedy import greedy
from poise.plan.infeasible import conflict
from poise.plan.portfolio import METHODS, Effort, decide
from poise.plan.problem import Problem
from poise.plan.result import Result, Step
from poise.plan.tables import tabulate

LONGEST = 1e9
"""A budget beyond this is as good as none [s]."""
LONGEST_TRACE = 20_000
"""How many trials (components x computers) a trace is written down for."""


def solve(  # noqa: PLR0913 - each says how to decide, and has a default
    problem: Problem,
    budget: float = 0.1,
    method: str = "auto",
    seed: int = 0,
    *,
    steps: int | None = None,
    fewer: bool = False,
    stop: Ask | None = None,
    why: bool = True,
) -> Result:
    """Return the best placement found within `budget` [s].

    Ctrl-C in the main thread ends the search, and the best placement so far is
    returned.

    Parameters
    ----------
    budget
        Time to decide [s], finite, >= 0; the greedy always runs to its end.
    method
        ``auto``: greedy, then proof and search as the budget allows; ``greedy``: the
        paper's; ``exact``: branch and bound until proven or out of budget; ``search``:
        the anytime search; ``cpsat``: OR-Tools, an independent certificate.
    seed
        Of the search, >= 0.
    steps
        Limit of search moves or nodes instead of the budget: then the same seed gives
        the same placement.
    fewer
        Put architectures aside, lowest priority first, when not all fits.
    stop
        Asked 50 times a second, in any thread, whether to return the best placement so
        far, such as ``threading.Event().is_set``. What it raises is raised.
    why
        Look for what cannot hold together where nothing holds, or not all that was put
        aside, and for the cheapest way out; that takes up to a second or two on top of
        the budget.

    Raises
    ------
    RobotError
        When the problem is wrong; the message lists everything that is.
    UsageError
        When the budget, method, seed or steps are not ones.
    """
    _check_call(budget, method, seed, steps)
    if not (stop is None or callable(stop)):
        raise UsageError(f"stop is {stop!r}, must be a function or None")
    check(problem)
    start = perf_counter()
    effort = Effort(float(min(budget, LONGEST)), steps, seed, stop)

    def part(smaller: Problem, share: float) -> Result:
        return decide(smaller, method, effort.share(share))

    if fewer or alternatives(problem):
        result = admit(problem, part, fewer=fewer)
    else:
        result = part(problem, 1.0)
    if why and method != "greedy":
        if not (result.feasible or result.placement):
            result = _explained(part_of(problem, result), result, stop)
        elif result.aside and not result.architectures:
            result = _explained(problem, result, stop)
    return replace(result, seconds=perf_counter() - start, seed=seed)


def _explained(problem: Problem, result: Result, stop: Ask | None) -> Result:
    """Add what in `problem` cannot hold together, as far as that is found."""
    found = conflict(problem, stop)
    if found is None:
        return result
    names, limits = ", ".join(found.components), "; ".join(found.limits)
    if not limits.startswith(names):
        limits = f"{names} cannot hold together: {limits}"
    reason = f"{limits}. Way out: {found.way_out}"
    result = replace(result, reason=reason, conflict=found)
    if result.feasible:
        return result
    return replace(result, proven=True, stopped_by="infeasible")


def trace(problem: Problem) -> tuple[Step, ...]:
    """Return every step of the paper's greedy, with all that it tried.

    Empty when it would be longer than 20,000 trials. Raises as `solve` does.
    """
    check(problem)
    if len(problem.components) * len(problem.computers) > LONGEST_TRACE:
        return ()
    return greedy(tabulate(problem))[1]


def _check_call(budget: float, method: str, seed: int, steps: int | None) -> None:
    given: object = budget
    if not (isinstance(given, float | int) and 0 <= given < inf):
        raise UsageError(f"budget is {budget!r} s, must be finite and >= 0")
    if method not in METHODS:
        raise UsageError(f"no method {method!r} (there are: {', '.join(METHODS)})")
    for name, count in (("seed", seed), ("steps", steps)):
        if name == "steps" and count is None:
            continue
        if not (isinstance(count, int) and 0 <= count < UNLIMITED):
            raise UsageError(
                f"{name} is {count!r}, must be a whole number in [0, 2^62)"
            )
