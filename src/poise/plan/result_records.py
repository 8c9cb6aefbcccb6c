"""Small records that results are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple, TypedDict

from msgspec import Struct
from msgspec.structs import replace

from poise.plan.problem.arrays import Placed
from poise.plan.problem.problem import Problem


class Terms(Struct, frozen=True, kw_only=True):
    """F and its parts, weights included: they add up to `total`.

    `move` holds every linear cost: of leaving the present computer, and what problems
    say that a component costs on a computer. `quality` is what a lesser alternative
    costs, `shortage` what is used beyond soft limits, and `time` what is beyond time
    limits that have a price.
    """

    total: float
    communication: float
    balance: float
    move: float = 0.0
    quality: float = 0.0
    shortage: float = 0.0
    time: float = 0.0

    def __sub__(self, other: Terms) -> Terms:
        """Return by how much each term is more than `other`'s."""
        names = self.__struct_fields__
        return Terms(**{k: getattr(self, k) - getattr(other, k) for k in names})

    def with_quality(self, cost: float) -> Terms:
        """Return F with this cost of a lesser alternative, instead of any other."""
        return replace(self, total=self.total - self.quality + cost, quality=cost)


Ask = Callable[[], bool]
"""Tells a solver, which asks up to 100 times a second, whether to stop now."""

Stopped = Literal["done", "proven", "budget", "interrupted", "infeasible"]
"""Why a solver stopped: it had no more to do, proved its answer, used up its budget,
was interrupted by the user, or proved that nothing can hold."""


class Answer(NamedTuple):
    """What a solver of the core hands back."""

    placed: Placed  # empty: no placement was found
    bound: float
    proven: bool
    stopped_by: str
    steps: int  # search moves tried, or nodes opened


class ComputerTried(Struct, frozen=True, kw_only=True):
    """One computer tried for a component: F over all placed so far.

    `total` is None where the component may not go; `reason` then says why.
    """

    computer: str
    total: float | None
    reason: str = ""


class GreedyStep(Struct, frozen=True, kw_only=True):
    """One step of the greedy: a component, what was tried, and what was chosen.

    Components that must share a computer are placed as one; their names are joined
    with ``+``. `chosen` is None when no computer could take it.
    """

    component: str
    trials: tuple[ComputerTried, ...]
    chosen: str | None


class Tightest(Struct, frozen=True, kw_only=True):
    """The resource that is closest to its limit; `used` is its share of that limit."""

    computer: str
    resource: str
    used: float


class Shortage(Struct, frozen=True, kw_only=True):
    """What components need on a computer beyond what they can use there."""

    computer: str
    resource: str
    amount: float


class TimeTaken(Struct, frozen=True, kw_only=True):
    """How long what a time limit is about takes on a placement [s].

    `price` is what F grows by for each share of `limit` beyond it; 0: it must be kept.
    """

    name: str
    limit: float
    seconds: float
    price: float


class More(Struct, frozen=True, kw_only=True):
    """A limit to be raised.

    Parameters
    ----------
    on
        A computer, the two ends of a link, or a time limit.
    resource
        Of the computer; or ``bandwidth`` or ``time``.
    amount
        By how much its capacity [the resource's unit], the link's bandwidth [bytes/s]
        or the time limit [s] must rise.
    """

    on: tuple[str, ...]
    resource: str
    amount: float


class Conflict(Struct, frozen=True, kw_only=True):
    """Why nothing can hold: an irreducible infeasible subset, and its relaxation.

    Parameters
    ----------
    components
        A set that cannot be placed, even alone.
    limits
        The limits that they cannot keep together, for people.
    irreducible
        Whether it is proven that without any one of them the others could hold.
    relaxation
        What has to give way so that the whole problem holds, for people: the smallest
        rise of limits where that is enough, of one rather than of several.
    more
        The rises in `relaxation`.
    price
        What `relaxation` takes: the sum of its rises, each as a share of the largest
        capacity of its kind, or of the time limit; None: other limits have to give way.
    """

    components: tuple[str, ...]
    limits: tuple[str, ...]
    relaxation: str
    irreducible: bool = True
    more: tuple[More, ...] = ()
    price: float | None = None


class Selection(NamedTuple):
    """What was chosen besides the placement."""

    # function -> the architecture chosen for it, where there was a choice
    architectures: Mapping[str, str] = {}
    suspended: tuple[str, ...] = ()  # architectures suspended because not all fits
    lost: float = 0.0  # what F grows by for the quality that was lost
    # the problem with nothing suspended, for one choice; None: nothing was, or the
    # choices are too many to explain
    whole: Problem | None = None
    why: str = ""  # why something was suspended, for people
    # the problems with other alternatives, where nothing holds with any
    others: tuple[Problem, ...] = ()


class PlainResult(TypedDict):
    """What is printed of a result with `--json`."""

    placement: Mapping[str, str]
    feasible: bool
    reason: str
    objective: Terms | None
    method: str
    proven: bool
    bound: float | None
    gap: float | None
    stopped_by: Stopped
    seconds: float
    seed: int
    tightest: Tightest | None
    shortages: tuple[Shortage, ...]
    times: tuple[TimeTaken, ...]
    trace: tuple[GreedyStep, ...]
    architectures: Mapping[str, str]
    suspended: tuple[str, ...]
    unknown: tuple[str, ...]
    scale: str
    spread: str
    conflict: Conflict | None
