"""What it costs in one phase to be elsewhere than in the phases beside it."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from poise.plan.phases.problem import MOVE, NEVER, PhasedProblem
from poise.plan.problem.problem import Problem

Placements = Mapping[str, Mapping[str, str]]
"""Phase -> component -> computer."""


def beside(problem: PhasedProblem) -> dict[str, dict[str, float]]:
    """Return phase -> the phases before and after it, and how often it goes there."""
    near: dict[str, dict[str, float]] = {p.name: {} for p in problem.phases}
    for phase in problem.phases:
        for before, often in phase.after.items():
            for one, two in ((phase.name, before), (before, phase.name)):
                near[one][two] = near[one].get(two, 0.0) + often
    return near


def with_moves(
    phased: PhasedProblem, phase: str, placements: Placements, *, start: bool = False
) -> Problem:
    """Return the problem of a phase, with the costs of moves to those beside it.

    They are spread over the time of the phase, as its F is the mean over that. Another
    alternative than in a phase beside it costs as if it moved.

    Parameters
    ----------
    placements
        Those of the phases beside it that are to count.
    start
        Whether the solver is to begin at the placement of the phase itself.
    """
    this = next(each for each in phased.phases if each.name == phase)
    problem = this.problem
    own = placements.get(phase, {}) if start else {}
    near = [
        (placements[name], often)
        for name, often in beside(phased)[phase].items()
        if name in placements
    ]
    function = {
        name: bundle.function
        for bundle in problem.architectures
        for name in bundle.components
    }
    of_function: dict[str, set[str]] = {}
    for bundle in problem.architectures:
        of_function.setdefault(bundle.function, set()).update(bundle.components)
    names = [computer.name for computer in problem.computers]
    components = []
    for component in problem.components:
        cost = {name: component.cost.get(name, 0.0) for name in names}
        for there, often in near:
            move = phased.move_cost(component.name, often, this.lasts)
            if component.name in there:
                for name in cost.keys() - {there[component.name]}:
                    cost[name] += move
            elif there.keys() & of_function.get(function.get(component.name, ""), ()):
                starts = MOVE * often / this.lasts
                for name in cost:
                    cost[name] += starts if move >= NEVER else move
        present = own.get(component.name, component.present)
        components.append(replace(component, cost=cost, present=present))
    return replace(problem, components=tuple(components))
