"""Chains whose deadline no placement keeps, by links, pins and capacities alone."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec.structs import replace

from poise.model.robot import Robot
from poise.model.yaml.tree import Finding
from poise.plan.from_robot import problem_of
from poise.plan.problem.changed_problem import keep_components
from poise.plan.why.conflict import conflict
from poise.units import format_seconds


def check_late_chains(robot: Robot) -> Iterator[Finding]:
    """Yield the chains whose data spends more time on links than their deadline."""
    if not robot.chains:
        return
    problem = problem_of(robot)
    for limit in problem.time_limits:
        part = keep_components(problem, {*limit.components})
        part = replace(part, time_limits=(), architectures=())
        if conflict(part) is not None:
            continue  # it has no place at all: that is said where it is placed
        found = conflict(replace(part, time_limits=(replace(limit, price=0.0),)))
        if found is not None:
            yield Finding(
                ("chains", limit.name, "deadline"),
                f"chain '{limit.name}' cannot keep its "
                f"{format_seconds(limit.limit)}, wherever its components run: "
                f"{'; '.join(found.limits)}. It could with {found.relaxation}",
            )
