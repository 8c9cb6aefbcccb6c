"""The paper's greedy (section IV-D): the specification that the C++ core mirrors.

Components that may run on one computer only come first; the others by size, largest
first. Each goes where F over all placed so far is smallest and every limit still
holds. Ties (within rounding) go to the lower index. Where the paper's text differs from
its own formula (its worked example puts C3 on the first computer), Poise follows the
formula.
"""

from __future__ import annotations

from poise.plan.records import GreedyStep, Trial
from poise.plan.reference import objective
from poise.plan.reference.limits import obstacle
from poise.plan.tables import Placed, Tables

ROUNDING = 1e-12
"""By how much two values of F may differ, relative to F (at least to 1), and be one."""


def order(tables: Tables) -> list[int]:
    """Return the units in the order in which the greedy places them."""
    pinned = {u for u, computers in tables.allowed.items() if len(computers) == 1}
    return sorted(
        range(tables.n), key=lambda u: (u not in pinned, -_size(tables, u), u)
    )


def _size(tables: Tables, unit: int) -> float:
    need = tables.demand[unit * tables.r : (unit + 1) * tables.r]
    return sum(w * d for w, d in zip(tables.size_weight, need, strict=True))


def greedy(tables: Tables) -> tuple[Placed, tuple[GreedyStep, ...]]:
    """Place every unit in turn; stop at the first that fits nowhere.

    Returns
    -------
    placed
        Unit -> computer; -1 for those that were not reached.
    trace
        Every step with every computer tried; the last one has no `chosen` when the
        greedy came to a dead end.
    """
    placed: Placed = [-1] * tables.n
    trace: list[GreedyStep] = []
    for unit in order(tables):
        trials = _trials(tables, placed, unit)
        best = _best(trials)
        name = "+".join(tables.problem.components[i].name for i in tables.members[unit])
        chosen = None if best is None else tables.problem.computers[best].name
        trace.append(GreedyStep(component=name, trials=trials, chosen=chosen))
        if best is None:
            break
        placed[unit] = best
    return placed, tuple(trace)


def _trials(tables: Tables, placed: Placed, unit: int) -> tuple[Trial, ...]:
    load = objective.loads(tables, placed)
    trials = []
    for h, computer in enumerate(tables.problem.computers):
        reason = obstacle(tables, placed, load, unit, h)
        trial = [*placed]
        trial[unit] = h
        total = None if reason else objective.terms(tables, trial).total
        trials.append(Trial(computer=computer.name, total=total, reason=reason))
    return tuple(trials)


def _best(trials: tuple[Trial, ...]) -> int | None:
    """Return the first computer whose F is lowest, within rounding."""
    totals = [float("inf") if t.total is None else t.total for t in trials]
    lowest = min(totals)
    if lowest == float("inf"):
        return None
    near = lowest + ROUNDING * max(1.0, abs(lowest))
    return next(h for h, total in enumerate(totals) if total <= near)


def dead_end(tables: Tables) -> str:
    """Return where the greedy comes to a dead end, and why."""
    last = greedy(tables)[1][-1]
    why = "; ".join(f"{trial.computer}: {trial.reason}" for trial in last.trials)
    return f"the greedy finds no computer for {last.component} ({why})"
