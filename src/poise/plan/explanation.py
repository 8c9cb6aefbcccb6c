"""Why a component is where it is, or why its architecture was not chosen."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.errors import UsageError
from poise.plan.alternatives import chosen_by, part
from poise.plan.planner import evaluate, solve
from poise.plan.problem.arrays import Placed
from poise.plan.problem.items import Bundle
from poise.plan.problem.problem import Problem
from poise.plan.result import CompiledProblem
from poise.plan.result_records import Terms
from poise.plan.violations import obstacle


class Option(Struct, frozen=True, kw_only=True):
    """One computer for a component, all others staying where they are.

    Parameters
    ----------
    objective
        The terms of F with the component there.
    change
        The terms of F there, less those of where it is.
    obstacle
        Which limit keeps it out; empty when none does.
    """

    computer: str
    objective: Terms
    change: Terms
    obstacle: str = ""


class Explanation(Struct, frozen=True, kw_only=True):
    """Why a component is on `computer`: all options, cheapest first.

    `together` names the components that must move along with it.
    """

    component: str
    computer: str
    reason: str
    options: tuple[Option, ...]
    together: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.component} is on {self.computer}: {self.reason}"


class Rejection(Struct, frozen=True, kw_only=True):
    """Why an architecture was not chosen.

    Parameters
    ----------
    chosen
        The architecture that provides its function instead; empty when none does.
    objective, change
        The terms of F at the best placement found with it, and those less the terms of
        the placement that is; None when it fits nowhere.
    """

    architecture: str
    chosen: str
    reason: str
    objective: Terms | None = None
    change: Terms | None = None

    def __str__(self) -> str:
        what = f"architecture {self.architecture} was not chosen"
        if self.chosen:
            what += f" ({self.chosen} provides its function)"
        return f"{what}: {self.reason}"


def explain(
    problem: Problem, placement: Mapping[str, str], name: str
) -> Explanation | Rejection:
    """Return why a component is where `placement` has it.

    Of an architecture that is not in the placement, or a component of it, return why
    it was not chosen: what the best placement with it costs.

    Raises
    ------
    UsageError
        When there is no such component or architecture, it was chosen but has no
        components, or the placement is not complete.
    """
    for bundle in problem.architectures:
        if name == bundle.name or name in bundle.components:
            if not placement.keys() & {*bundle.components}:
                return _rejection(problem, placement, bundle)
            if name == bundle.name and name not in placement:
                name = bundle.components[0]
    _, placed_part = chosen_by(problem, placement, partial=True)
    compiled = CompiledProblem(placed_part, given=placement)
    arrays = compiled.arrays
    placed = arrays.placed(placement)
    names = [c.name for c in placed_part.components]
    if name not in names:
        choices = ", ".join([*names, *(a.name for a in problem.architectures)])
        raise UsageError(f"no component is called {name!r} (there are: {choices})")
    unit = arrays.unit_of[names.index(name)]
    options = sorted(
        (_option(compiled, placed, unit, h) for h in range(arrays.m)),
        key=lambda option: (bool(option.obstacle), option.objective.total),
    )
    together = [names[i] for i in arrays.members[unit]]
    return Explanation(
        component=name,
        computer=problem.computers[placed[unit]].name,
        reason=_reason(problem, options, placement[name]),
        options=tuple(options),
        together=tuple(other for other in together if other != name),
    )


def _rejection(
    problem: Problem, placement: Mapping[str, str], bundle: Bundle
) -> Rejection:
    """Place it instead of its alternative, with what else runs, by any alternatives."""
    rivals = [
        b
        for b in problem.architectures
        if b.function == bundle.function and bundle.function and b != bundle
    ]
    placed = [b for b in problem.architectures if placement.keys() & {*b.components}]
    rival = next((b for b in rivals if b in placed), None)
    if rival is None and not bundle.components:
        raise UsageError(
            f"architecture {bundle.name!r} was chosen, and has no component to explain"
        )
    served = {b.function for b in placed if b.function}
    others = [
        b
        for b in problem.architectures
        if b != bundle and b not in rivals and (b in placed or b.function in served)
    ]
    instead = solve(part(problem, [*others, bundle]))
    present = part(problem, others if rival is None else [*others, rival])
    now = evaluate(present, placement)
    chosen = "" if rival is None else rival.name
    if instead.objective is None or now.objective is None:
        reason = f"with it, {instead.reason}"
        return Rejection(architecture=bundle.name, chosen=chosen, reason=reason)
    # Both against the best quality that there is.
    best = max([bundle.quality, *(b.quality for b in rivals)])
    weight = problem.objective.quality
    with_it = instead.objective.with_quality(
        instead.objective.quality + (best - bundle.quality) * weight
    )
    lost = 0.0 if rival is None else best - rival.quality
    change = with_it - now.objective.with_quality(now.objective.quality + lost * weight)
    reason = (
        f"the best placement with it costs {change.total:.4g} more ({_most(change)})"
        if change.total >= 0
        else f"it would lower F by {-change.total:.4g}"
    )
    return Rejection(
        architecture=bundle.name,
        chosen=chosen,
        reason=reason,
        objective=with_it,
        change=change,
    )


def _most(change: Terms) -> str:
    """Return the term that rises most, and by how much."""
    terms = {
        "communication": change.communication,
        "balance": change.balance,
        "moving": change.move,
        "quality": change.quality,
        "shortage": change.shortage,
        "time": change.time,
    }
    most = max(terms, key=lambda name: terms[name])
    return f"{most} {terms[most]:+.4g}"


def _option(
    compiled: CompiledProblem, placed: Placed, unit: int, computer: int
) -> Option:
    trial, lifted = [*placed], [*placed]
    trial[unit], lifted[unit] = computer, -1
    there = compiled.terms(trial)
    return Option(
        computer=compiled.arrays.computer(computer),
        objective=there,
        change=there - compiled.terms(placed),
        obstacle=obstacle(compiled.arrays, lifted, unit, computer),
    )


def _reason(problem: Problem, options: list[Option], here: str) -> str:
    possible = [option for option in options if not option.obstacle]
    others = [option for option in possible if option.computer != here]
    if len(problem.computers) == 1:
        return "it is the only computer"
    if all(option.computer != here for option in possible):
        return f"it breaks a limit on {here}"
    if not others:
        return "no other computer can take it"
    change = others[0].change
    if change.total < 0:
        return f"{others[0].computer} would lower F by {-change.total:.4g}"
    # What speaks most against the next best computer.
    return (
        f"the next best, {others[0].computer}, costs {change.total:.4g} more "
        f"({_most(change)})"
    )
