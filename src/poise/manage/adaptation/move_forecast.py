"""What a move would change, and what else could be done instead of it. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from msgspec import Struct

from poise import plan
from poise.errors import RobotError, UsageError
from poise.manage.adaptation.decision import (
    DOWNTIME,
    HORIZON,
    WORTH,
    cost_of,
    move_costs,
)
from poise.manage.adaptation.proposal import share_what_is_left, with_costs
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
    """Return what a move would change."""
    before = situation.placement
    computers = {c.name: c for c in situation.robot.computers}
    if component not in before:
        raise UsageError(f"component '{component}' does not run")
    if computer not in computers:
        raise UsageError(f"there is no computer '{computer}': {', '.join(computers)}")
    source, after = before[component], {**before, component: computer}
    if source == computer:
        raise UsageError(f"component '{component}' runs on '{computer}' already")
    robot = situation.robot_now
    problem = plan.keep_components(plan.problem_of(robot), before.keys())
    now, then = plan.evaluate(problem, before), plan.evaluate(problem, after)
    assert now.objective is not None  # noqa: S101, a given placement has terms
    assert then.objective is not None  # noqa: S101, the same
    step = TransitionStep(component, source, computer)
    demands = robot.demands("cpu")
    sizes = {c.name: c.snapshot for c in components_of(situation.statuses)}
    return WhatIf(
        component=component,
        source=source,
        target=computer,
        now=now.objective,
        then=then.objective,
        breaks=tuple(_new_breaks(robot, before, component, computer)),
        trouble=now.reason,
        loads={
            name: (_load(demands, before, name), _load(demands, after, name))
            for name in (source, computer)
        },
        usable={name: computers[name].usable("cpu") for name in (source, computer)},
        downtime=situation.downtimes.get(component, DOWNTIME),
        cost=cost_of(situation, [step]),
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
    """Return what could be done now: first nothing, then single moves, the best first.

    None when some component can run nowhere.
    """
    situation = situation.of_running_components()
    robot, now = situation.robot_now, situation.placement
    try:
        functions = situation.functions()
        problem = plan.problem_of(robot, functions=functions, present=now)
    except RobotError:
        return ()
    costs = move_costs(situation)
    problem = with_costs(problem, {name: x / WORTH for name, x in costs.items()})
    problem = plan.keep_components(problem, now.keys())
    problem = share_what_is_left(problem, situation, HORIZON / WORTH)

    def work_out(short: float, step: TransitionStep | None) -> Alternative:
        after = {**now, step.component: step.target} if step else now
        result = plan.evaluate(problem, after)
        assert result.objective is not None  # noqa: S101, a given placement has terms
        return Alternative(
            what=str(step) if step else "stay",
            total=result.objective.total,
            short=short,
            cost=cost_of(situation, [step]) if step else 0.0,
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
) -> Iterator[tuple[float, TransitionStep | None]]:
    """Yield what CPU is missing [cores]: as it is, and after each move."""
    demands = robot.demands("cpu")
    left = {name: amounts["cpu"] for name, amounts in residue(robot, now).items()}
    short = sum(max(0.0, -amount) for amount in left.values())
    yield short, None
    allowed = allowed_computers(robot)
    movable = {c.name for c in robot.components() if c.movable}
    for component, source in now.items():
        for target in (
            sorted(allowed[component] - {source}) if component in movable else ()
        ):
            change = {source: demands[component], target: -demands[component]}
            yield (
                short
                + sum(
                    max(0.0, -left[at] - more) - max(0.0, -left[at])
                    for at, more in change.items()
                ),
                TransitionStep(component, source, target),
            )


def _load(
    demands: Mapping[str, float], placement: Mapping[str, str], computer: str
) -> float:
    return sum(demands[name] for name, at in placement.items() if at == computer)


def check_move(situation: Situation, component: str, computer: str) -> None:
    """Raise UsageError when a component does not fit on a computer with all others.

    Limits that are broken without it do not count.
    """
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
