"""What a solver answers: a placement that explains itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from msgspec import Struct

Stopped = Literal["done", "proven", "budget", "interrupted", "infeasible"]
"""Why a solver stopped: it had no more to do, proved its answer, used up its budget,
was interrupted by the user, or proved that nothing can hold."""


class Terms(Struct, frozen=True, kw_only=True):
    """F and its parts, weights included: they add up to `total`.

    `move` holds every linear cost: of leaving the present computer, and of the
    problem's cost matrix. `quality` is what a lesser alternative costs.
    """

    total: float
    communication: float
    balance: float
    move: float = 0.0
    quality: float = 0.0


class Trial(Struct, frozen=True, kw_only=True):
    """One computer tried for a component: F over all placed so far.

    `total` is None where the component may not go; `reason` then says why.
    """

    computer: str
    total: float | None
    reason: str = ""


class Step(Struct, frozen=True, kw_only=True):
    """One step of the greedy: a component, what was tried, and what was chosen.

    Components that must share a computer are placed as one; their names are joined
    with ``+``. `chosen` is None when no computer could take it.
    """

    component: str
    trials: tuple[Trial, ...]
    chosen: str | None


class Tightest(Struct, frozen=True, kw_only=True):
    """The resource that is closest to its limit; `used` is its share of that limit."""

    computer: str
    resource: str
    used: float


class More(Struct, frozen=True, kw_only=True):
    """A limit to be raised.

    Parameters
    ----------
    on
        A computer, or the two ends of a link.
    resource
        Of the computer; or ``bandwidth``.
    amount
        By how much its capacity [the resource's unit] or the link's bandwidth
        [bytes/s] must rise.
    """

    on: tuple[str, ...]
    resource: str
    amount: float


class Conflict(Struct, frozen=True, kw_only=True):
    """Why nothing can hold.

    Parameters
    ----------
    components
        A small set that cannot be placed, even alone.
    limits
        The limits that they cannot keep together, for people.
    way_out
        What has to give way so that the whole problem holds, for people: the smallest
        rise of one capacity where that is enough.
    more
        The rises in `way_out`.
    """

    components: tuple[str, ...]
    limits: tuple[str, ...]
    way_out: str
    more: tuple[More, ...] = ()


class Result(Struct, frozen=True, kw_only=True):
    """A placement and everything that can be said about it.

    Parameters
    ----------
    placement
        Component -> computer; empty when none was found.
    feasible
        Whether it keeps every limit.
    reason
        Why it is not feasible, or why architectures were put aside, for people; empty
        when it is feasible with all of them.
    conflict
        Which components and limits cannot hold together, with those put aside; None
        when not known.
    objective
        The terms of F; None without a placement.
    method
        What found the placement.
    seconds
        How long deciding took [s].
    bound
        No placement has a lower F than this; None when nothing is known.
    proven
        Whether no placement is better (or, when infeasible, none exists).
    stopped_by
        Why the solver stopped.
    scale, spread
        How F was measured (docs/design/objective.md).
    tightest
        The resource closest to its limit; None without a placement.
    trace
        What the greedy tried first, step by step.
    architectures
        Function -> the architecture chosen for it, where there was a choice.
    aside
        Architectures put aside because not all fits.
    """

    placement: Mapping[str, str]
    feasible: bool
    reason: str = ""
    conflict: Conflict | None = None
    objective: Terms | None = None
    method: str = "greedy"
    seconds: float = 0.0
    bound: float | None = None
    proven: bool = False
    stopped_by: Stopped = "done"
    seed: int = 0
    scale: str = "normalised"
    spread: str = "range"
    tightest: Tightest | None = None
    trace: tuple[Step, ...] = ()
    architectures: Mapping[str, str] = {}
    aside: tuple[str, ...] = ()

    @property
    def gap(self) -> float | None:
        """How far F may be above the optimum, as a share of F; None when unknown."""
        if self.objective is None or self.bound is None:
            return None
        if self.proven or self.objective.total <= self.bound:
            return 0.0
        return (self.objective.total - self.bound) / abs(self.objective.total)
