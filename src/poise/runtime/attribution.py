"""Whose CPU time it was: a call runs on its caller's thread, for its callee."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping

from poise.runtime.wiring import OpenEnds, Runners


def called_cpu(runners: Runners, ends: Iterable[OpenEnds]) -> Mapping[str, float]:
    """Return what calls add to, or take from, the CPU time of components' threads [s].

    A connector counts its calls' CPU time with all that they called in turn, so a
    component's own is that of its thread, plus the calls into it, less those out of it.
    Calls from other containers run on threads of their transport: nobody else loses.
    """
    moved: dict[str, float] = defaultdict(float)
    for each in ends:
        spec, cpu = each.spec, each.counts.cpu
        if cpu and (spec.target, spec.target_epoch) in runners:
            moved[spec.target] += cpu
            if (spec.source, spec.source_epoch) in runners:
                moved[spec.source] -= cpu
    return moved


def calls_served(runners: Runners, ends: Iterable[OpenEnds]) -> Mapping[str, int]:
    """Return how many calls each component here has answered."""
    calls: dict[str, int] = defaultdict(int)
    for each in ends:
        if (each.spec.target, each.spec.target_epoch) in runners:
            calls[each.spec.target] += each.counts.calls
    return calls
