"""The paper's greedy (section IV-D): the specification that the C++ core mirrors.

Components that may run on one computer only come first; the others by size, largest
first. Each goes where F over all placed so far is smallest and every limit still holds;
a limit of time where it can still hold. Ties (within rounding) go to the lower index.
Where the paper's text differs from its own formula (its worked example puts C3 on the
first computer), Poise follows the formula.
"""

from math import inf

from poise.plan.problem.arrays import Arrays, Placed
from poise.plan.violations import obstacle
from tests.plan.reference import objective, time

ROUNDING = 1e-12
"""By how much two values of F may differ, relative to F (at least to 1), and be one."""


def order(arrays: Arrays) -> list[int]:
    """Return the units in the order in which the greedy places them."""
    pinned = {u for u, computers in arrays.allowed.items() if len(computers) == 1}
    return sorted(
        range(arrays.n), key=lambda u: (u not in pinned, -_size(arrays, u), u)
    )


def _size(arrays: Arrays, unit: int) -> float:
    need = arrays.demand[unit * arrays.r : (unit + 1) * arrays.r]
    return sum(w * d for w, d in zip(arrays.size_weight, need, strict=True))


def greedy(arrays: Arrays) -> Placed:
    """Place every unit in turn; stop at the first that fits nowhere.

    Those that were not reached stay at -1.
    """
    placed: Placed = [-1] * arrays.n
    for unit in order(arrays):
        totals = [_total(arrays, placed, unit, h) for h in range(arrays.m)]
        lowest = min(totals)
        if lowest == inf:
            break
        near = lowest + ROUNDING * max(1.0, abs(lowest))
        placed[unit] = next(h for h, total in enumerate(totals) if total <= near)
    return placed


def _total(arrays: Arrays, placed: Placed, unit: int, computer: int) -> float:
    """Return F over all placed so far, and `unit` on a computer; where it may be."""
    trial = [*placed]
    trial[unit] = computer
    if obstacle(arrays, placed, unit, computer) or time.is_late(arrays, trial):
        return inf
    return objective.terms(arrays, trial).total
