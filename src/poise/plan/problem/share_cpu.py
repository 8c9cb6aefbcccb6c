"""When there is too little CPU: shared, by priority, instead of nothing that fits.

CPU can be shared: what gets less of it does less. Memory and devices cannot, so their
limits stay hard. Where components of several priorities share a computer, the higher
ones get what they need first; so work that is not done is counted by how much each
priority counts (`poise.model.software`), and the shortage of a priority is what it
and all above it need together beyond what there is, less that of those above alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from msgspec.structs import replace

from poise.model.software import importance
from poise.plan.problem.items import SoftLimit
from poise.plan.problem.problem import Problem

PRICE = 1000.0
"""What F grows by for each core that is short, of the lowest priority: far more than
all other terms come to."""
_RESERVE = 0.01
"""What a core of the reserve costs that is used, as a share of one that is short."""


class Margin(NamedTuple):
    """What placements leave free where they can.

    Parameters
    ----------
    limits
        Computer -> how much may be used beside it [cores]; where not named, what the
        computer can use beside its reserve.
    share
        What a core beyond that costs, as a share of one that is short.
    """

    limits: Mapping[str, float]
    share: float


def share_cpu(
    problem: Problem,
    price: float = PRICE,
    limits: Mapping[str, float] | None = None,
    margins: Sequence[Margin] = (Margin({}, _RESERVE),),
) -> Problem:
    """Return the problem with CPU that is shared where it is short.

    Parameters
    ----------
    price
        What F grows by for each core that is short, of the lowest priority; > 0.
    limits
        Computer -> what there is [cores]; all that it has, where not named.
    margins
        What is left free besides, where possible.
    """
    has = {h.name: h.total("cpu") for h in problem.computers} | {**(limits or {})}
    priority = dict.fromkeys((c.name for c in problem.components), _lowest(problem))
    for bundle in problem.architectures:
        for name in bundle.components:
            priority[name] = max(priority[name], bundle.priority)
    counts = importance(priority.values())
    steps = pairwise([0.0, *counts.values()])
    work = [
        SoftLimit(
            resource="cpu",
            price=price * (more - less),
            limits=has,
            components=tuple(name for name, p in priority.items() if p >= least),
        )
        for least, (less, more) in zip(counts, steps, strict=False)
    ]
    left = [
        SoftLimit(resource="cpu", price=price * share, limits=most)
        for most, share in margins
        if share > 0
    ]
    others = [each for each in problem.soft_limits if each.resource != "cpu"]
    return replace(problem, soft_limits=(*others, *work, *left))


def _lowest(problem: Problem) -> int:
    return min((bundle.priority for bundle in problem.architectures), default=0)
