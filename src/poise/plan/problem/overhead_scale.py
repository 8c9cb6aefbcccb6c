"""What a unit of overhead counts for: one number for a problem and all its parts.

So F of alternatives, of what is left when something is put aside, and of the phases of
a task can be compared (docs/design/objective.md).
"""

from __future__ import annotations

from math import inf

from poise.plan.problem.problem import Problem

LEAST_LINK_USE = 0.1
"""What communication counts for at least, however little of the links it takes: a
message between computers costs time on both of them, too."""


def overhead_scale(problem: Problem, overhead: float, traffic: float) -> float:
    """Return what a unit of overhead counts for in the communication term.

    In the normalised scale all overhead together counts for the share of the narrowest
    link that all traffic together would take, between a tenth and 1; for 1 where no
    bandwidth or no traffic is known.
    """
    if problem.objective.scale == "paper":
        return 1.0
    if problem.overhead_scale is not None:
        return problem.overhead_scale
    if overhead <= 0:
        return 0.0
    narrowest = min((link.bandwidth for link in problem.links), default=inf)
    use = traffic / narrowest if traffic > 0 and 0 < narrowest < inf else 1.0
    return min(1.0, max(LEAST_LINK_USE, use)) / overhead
