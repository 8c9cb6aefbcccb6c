"""Why a component is where it is, and what each other computer would cost."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.errors import UsageError
from poise.plan import objective
from poise.plan.check import check
from poise.plan.describe import placed_by_name
from poise.plan.limits import obstacle
from poise.plan.problem import Problem
from poise.plan.result import Terms
from poise.plan.tables import Placed, Tables, tabulate


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


def explain(
    problem: Problem, placement: Mapping[str, str], component: str
) -> Explanation:
    """Return why `component` is where `placement` has it.

    Raises
    ------
    RobotError
        When the problem is wrong.
    UsageError
        When there is no such component, or the placement is not complete.
    """
    check(problem)
    tables = tabulate(problem)
    placed = placed_by_name(tables, placement)
    names = [c.name for c in problem.components]
    if component not in names:
        choices = ", ".join(names)
        raise UsageError(f"no component is called {component!r} (there are: {choices})")
    unit = tables.unit_of[names.index(component)]
    options = sorted(
        (_option(tables, placed, unit, h) for h in range(tables.m)),
        key=lambda option: (bool(option.obstacle), option.objective.total),
    )
    together = [names[i] for i in tables.members[unit]]
    return Explanation(
        component=component,
        computer=problem.computers[placed[unit]].name,
        reason=_reason(problem, options, placement[component]),
        options=tuple(options),
        together=tuple(name for name in together if name != component),
    )


def _option(tables: Tables, placed: Placed, unit: int, computer: int) -> Option:
    now = objective.terms(tables, placed)
    trial = [*placed]
    trial[unit] = computer
    there = objective.terms(tables, trial)
    lifted = [*placed]
    lifted[unit] = -1
    load = objective.loads(tables, lifted)
    return Option(
        computer=tables.problem.computers[computer].name,
        objective=there,
        change=Terms(
            total=there.total - now.total,
            communication=there.communication - now.communication,
            balance=there.balance - now.balance,
            move=there.move - now.move,
        ),
        obstacle=obstacle(tables, lifted, load, unit, computer),
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
    terms = {
        "communication": change.communication,
        "balance": change.balance,
        "moving": change.move,
    }
    if change.total < 0:
        return f"{others[0].computer} would lower F by {-change.total:.4g}"
    # What speaks most against the next best computer.
    most = max(terms, key=lambda name: terms[name])
    return (
        f"the next best, {others[0].computer}, costs {change.total:.4g} more "
        f"({most} {terms[most]:+.4g})"
    )
