"""What it costs in one phase to be elsewhere than in the phases beside it."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from poise.plan.phases.problem import MOVE, NEVER, PhasedProblem
from poise.plan.problem.problem import Problem

Placements = Mapping[str, Mapping[str, str]]
"""Phase -> component -> computer."""


def beside(problem: PhasedProblem) -> dict[str, tuple[str, ...]]:
    """Return phase -> the phases that it may follow, or that may follow it."""
    pairs = [(before, p.name) for p in problem.phases for before in p.after]
    return {
        p.name: tuple(
            dict.fromkeys(
                one if two == p.name else two
                for one, two in pairs
                if p.name in (one, two)
            )
        )
        for p in problem.phases
    }


def with_moves(
    phased: PhasedProblem, phase: str, placements: Placements, *, start: bool = False
) -> Problem:
    """Return the problem of a phase, with the costs of moves to those beside it.

    Another alternative than in a phase beside it costs as if it moved.

    Parameters
    ----------
    placements
        Those of the phases beside it that are to count.
    start
        Whether the solver is to begin at the placement of the phase itself.
    """
    problem = next(each.problem for each in phased.phases if each.name == phase)
    own = placements.get(phase, {}) if start else {}
    near = [placements[name] for name in beside(phased)[phase] if name in placements]
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
        move = phased.move.get(component.name, 0.0)
        cost = {name: component.cost.get(name, 0.0) for name in names}
        for there in near:
            if component.name in there:
                for name in cost.keys() - {there[component.name]}:
                    cost[name] += move
            elif there.keys() & of_function.get(function.get(component.name, ""), ()):
                for name in cost:
                    cost[name] += MOVE if move >= NEVER else move
        present = own.get(component.name, component.present)
        components.append(replace(component, cost=cost, present=present))
    return replace(problem, components=tuple(components))
