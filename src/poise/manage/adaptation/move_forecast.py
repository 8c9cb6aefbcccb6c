"""What a move would change, and what else could be done instead of it. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError, UsageError
from poise.manage.adaptation.decision import HORIZON, WORTH, move_costs
from poise.manage.adaptation.proposal import (
    problem_now,
    share_what_is_left,
    terms_of,
    with_time_limits,
)
from poise.manage.adaptation.situation import Situation
from poise.manage.agent_connections.statuses import components_of
from poise.manage.migration.migration_report import TransitionStep, WhatIf
from poise.manage.migration.transition_plan import residue
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot

_MOST_TRIED = 16
"""So many moves are worked out: those that leave least CPU missing."""
_MOST_KEPT = 5
"""So many alternatives are kept."""


def what_if(situation: Situation, component: str, computer: str) -> WhatIf:
    """Return what a move would change, beside what other programs take of the CPU."""
    before = situation.placement
    computers = {c.name: c for c in situation.robot.computers}
    if component not in before:
        raise UsageError(f"component '{component}' does not run")
    if computer not in computers:
        raise UsageError(f"there is no computer '{computer}': {', '.join(computers)}")
    source, after = before[component], {**before, component: computer}
    if source == computer:
        raise UsageError(f"component '{component}' runs on '{computer}' already")
    robot, problem = situation.robot_now, problem_now(situation)
    left = {c.name: c for c in situation.computers_left()}
    as_it_is = plan.evaluate(replace(problem, computers=(*left.values(),)), before)
    problem = with_time_limits(problem, situation, plan.PRICE)
    problem = share_what_is_left(problem, situation, None)
    demands = robot.demands("cpu")
    sizes = {c.name: c.snapshot for c in components_of(situation.statuses)}
    return WhatIf(
        component=component,
        source=source,
        target=computer,
        now=terms_of(problem, before),
        then=terms_of(problem, after),
        breaks=tuple(_new_breaks(robot, before, component, computer)),
        trouble=as_it_is.reason,
        loads={
            name: (_load(demands, before, name), _load(demands, after, name))
            for name in (source, computer)
        },
        usable={name: left[name].usable("cpu") for name in (source, computer)},
        downtime=situation.downtimes.get(component),
        cost=move_costs(situation)[component],
        state=sizes.get(component, 0),
    )


class Alternative(Struct, frozen=True, kw_only=True):
    """What else could have been done: a single move, or nothing."""

    what: str  # for people
    total: float  # f, with the cost of the move, and of CPU that is short
    short: float  # the CPU that components would need and not have [cores]
    cost: float = 0.0  # work that the move would cost [core-seconds]
    # the limits but of CPU that would be broken, for people; empty: none
    breaks: str = ""


def alternatives(situation: Situation) -> tuple[Alternative, ...]:
    """Return what could be done now: first nothing, then single moves by worth."""
    situation = situation.of_running_components()
    now, costs = situation.placement, move_costs(situation)
    try:
        problem = problem_now(
            situation, costs={name: cost / WORTH for name, cost in costs.items()}
        )
    except RobotError:
        return ()
    problem = share_what_is_left(problem, situation, HORIZON / WORTH)

    def work_out(short: float, steps: tuple[TransitionStep, ...]) -> Alternative:
        after = {**now, **{step.component: step.target for step in steps}}
        result = plan.evaluate(problem, after)
        assert result.objective is not None  # noqa: S101, a given placement has terms
        return Alternative(
            what=", ".join(map(str, steps)) or "stay",
            total=result.objective.total,
            short=short,
            cost=sum(costs[step.component] for step in steps),
            breaks=result.reason,
        )

    stays, *moves = _single_moves(situation.left().robot_now, now)
    moves.sort(key=lambda move: move[0])
    found = [work_out(*move) for move in moves[:_MOST_TRIED]]
    found.sort(
        key=lambda alternative: (
            bool(alternative.breaks),
            alternative.short,
            alternative.total,
        )
    )
    return (work_out(*stays), *found[:_MOST_KEPT])


def _single_moves(
    robot: Robot, now: Mapping[str, str]
) -> Iterator[tuple[float, tuple[TransitionStep, ...]]]:
    """Yield what CPU is missing [cores]: as it is, and after each move."""
    demands = robot.demands("cpu")
    left = {
        name: amounts.get("cpu", 0.0) for name, amounts in residue(robot, now).items()
    }
    yield _missing(left), ()
    allowed = allowed_computers(robot)
    movable = {c.name for c in robot.components() if c.movable}
    for group in _groups(robot, now):
        for target in sorted(set.intersection(*({*allowed[name]} for name in group))):
            steps = tuple(
                TransitionStep(name, now[name], target)
                for name in group
                if now[name] != target
            )
            if not steps or not movable.issuperset(s.component for s in steps):
                continue
            after = dict(left)
            for step in steps:
                after[step.source] += demands[step.component]
                after[target] -= demands[step.component]
            yield _missing(after), steps


def _missing(left: Mapping[str, float]) -> float:
    return sum(max(0.0, -amount) for amount in left.values())


def _groups(robot: Robot, names: Iterable[str]) -> list[list[str]]:
    """Return the components that must share a computer, and each of the others."""
    groups = [[name] for name in names]
    for together in robot.together:
        joined = [name for group in groups if {*group} & {*together} for name in group]
        groups = [group for group in groups if not {*group} & {*together}]
        groups += [joined] if joined else []
    return groups


def _load(
    demands: Mapping[str, float], placement: Mapping[str, str], computer: str
) -> float:
    return sum(demands[name] for name, at in placement.items() if at == computer)


def check_move(situation: Situation, component: str, computer: str) -> None:
    """Raise UsageError when a move breaks a limit that is not broken without it."""
    allowed = allowed_computers(situation.robot, layers_stay=False)
    if component not in situation.placement or computer not in allowed[component]:
        return  # the move itself says so
    if new := _new_breaks(
        situation.robot_now, situation.placement, component, computer
    ):
        raise UsageError(
            f"component '{component}' does not fit on '{computer}' ({'; '.join(new)}); "
            "`--force` moves it anyway"
        )


def _new_breaks(
    robot: Robot, placement: Mapping[str, str], component: str, computer: str
) -> list[str]:
    """Return the limits that a component would break there, in the planner's words."""
    others = {name: at for name, at in placement.items() if name != component}
    before = _broken(robot, others)
    after = _broken(robot, {**others, component: computer})
    return [limit for limit in after if limit not in before]


def _broken(robot: Robot, placement: Mapping[str, str]) -> Sequence[str]:
    """Return the limits that a placement breaks, in the planner's words."""
    if not placement:
        return []
    problem = plan.keep_components(plan.problem_of(robot), placement.keys())
    return plan.evaluate(problem, placement).broken
