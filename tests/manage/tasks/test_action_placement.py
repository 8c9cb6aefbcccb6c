"""Where the functions of actions go that begin."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.estimate.online import Estimate
from poise.manage.adaptation.situation import Situation
from poise.manage.observe.estimates import DemandEstimate
from poise.manage.tasks.action_placement import PlanOverTime, room_for_functions
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Robot,
    Task,
)


def test_of_alternatives_that_two_tasks_planned_with_one_begins() -> None:
    """Else the tasks would stand still from then on."""
    robot = Robot(
        name="r",
        computers=(Computer(name="x", capacity={"cpu": 1.0, "memory": 1e9}),),
        architectures=tuple(
            Architecture(
                name=name,
                function="see",
                components=(ComponentEntry(name=f"{name}-eye"),),
            )
            for name in ("one", "other")
        ),
    )
    situation = Situation(robot=robot, placement={})
    planned = {"one-eye": "x", "other-eye": "x"}
    room = room_for_functions(situation, ["see"], planned)
    assert (room.begins, room.why) == ({"one-eye": "x"}, "")


def test_without_any_computer_there_is_no_room() -> None:
    """As it seems to a manager that stood still for a while."""
    see = ComponentEntry(name="eye", demand={"cpu": 0.1})
    robot = Robot(
        name="r",
        computers=(Computer(name="x", capacity={"cpu": 1.0, "memory": 1e9}),),
        architectures=(Architecture(name="see", function="see", components=(see,)),),
    )
    now = Estimate(mean=0.2, p95=0.2, error=0.01, starved=0.0)
    estimate = DemandEstimate(
        component="eye", computer="x", expected=None, estimate=now
    )
    situation = Situation(
        robot=robot,
        placement={"eye": "x"},
        lost=frozenset("x"),
        demand_estimates=(estimate,),
    )
    assert room_for_functions(situation, ["see"], {}).why


@pytest.mark.parametrize(
    ("only", "planned"), [((), {"eye": "x"}), (("x", "y"), {})], ids=["plan", "only"]
)
def test_what_was_to_run_on_a_lost_computer_begins_on_another(
    only: tuple[str, ...], planned: dict[str, str]
) -> None:
    eye = ComponentEntry(name="eye", only=only)
    robot = Robot(
        name="r",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 1.0, "memory": 1e9})
            for name in ("x", "y")
        ),
        architectures=(Architecture(name="see", function="see", components=(eye,)),),
    )
    situation = Situation(robot=robot, placement={}, lost=frozenset("x"))
    room = room_for_functions(situation, ["see"], planned)
    assert (room.begins, room.why) == ({"eye": "y"}, "")


def robot_of(**needs: float) -> Robot:
    """Return functions whose components need so many cores, and two computers of 1."""
    return Robot(
        name="r",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 1.0, "memory": 1e9})
            for name in ("x", "y")
        ),
        architectures=tuple(
            Architecture(
                name=name,
                function=name,
                components=(ComponentEntry(name=f"{name}er", demand={"cpu": need}),),
            )
            for name, need in needs.items()
        ),
    )


def test_what_was_planned_where_no_room_is_any_more_begins_elsewhere() -> None:
    situation = Situation(robot=robot_of(see=0.6, go=0.6), placement={"seeer": "x"})
    room = room_for_functions(situation, ["see", "go"], {"goer": "x"})
    assert (room.begins, room.moves, room.why) == ({"goer": "y"}, (), "")


def test_what_runs_stays_where_more_would_fit_by_a_move() -> None:
    """Where it need not move it does not: 0.3 beside 0.6, and 0.9 on the other."""
    robot = robot_of(see=0.3, say=0.6, go=0.9)
    apart = Situation(robot=robot, placement={"seeer": "x", "sayer": "x"})
    room = room_for_functions(apart, ["see", "say", "go"], {})
    assert (room.begins, room.moves) == ({"goer": "y"}, ())
    apart = Situation(robot=robot, placement={"seeer": "x", "sayer": "y"})
    room = room_for_functions(apart, ["see", "say", "go"], {})
    (move,) = room.moves
    assert room.begins == {"goer": move.source}


def test_of_alternatives_the_one_that_runs_goes_on() -> None:
    """The other would need less, and be of more worth."""
    robot = robot_of(see=0.9)
    small = Architecture(
        name="small",
        function="see",
        success=1.0,
        components=(ComponentEntry(name="small-eye", demand={"cpu": 0.1}),),
    )
    chosen = replace(robot.architectures[0], success=0.1)
    robot = replace(robot_of(go=0.1), architectures=(chosen, small))
    situation = Situation(robot=robot, placement={"seeer": "x"})
    assert room_for_functions(situation, ["see"], {"small-eye": "x"}).begins == {}
    room = room_for_functions(replace(situation, placement={}), ["see"], {})
    assert [*room.begins] == ["small-eye"]


def test_a_plan_over_time_says_where_what_runs_in_a_phase_goes_and_nothing_else() -> (
    None
):
    actions = (
        Action(name="look", functions=("see", "go")),
        Action(name="tell", functions=("say",)),
    )
    tasks = (
        Task(name="t", actions=actions),
        Task(name="never", actions=(Action(name="a", functions=("huge",)),)),
    )
    robot = replace(robot_of(see=0.6, go=0.6, say=0.1, huge=7.0), tasks=tasks)
    plans = PlanOverTime(robot, solve_steps=100)
    found = plans.placement("t", ("look",), ("see", "go"))
    assert found.keys() == {"seeer", "goer"}
    assert {*found.values()} == {"x", "y"}
    assert plans.placement("t", ("look",), ("see",)).keys() == {"seeer"}
    assert plans.placement("t", ("tell",), ("say",)).keys() == {"sayer"}
    assert plans.placement("t", ("sing",), ("say",)) == {}
    assert plans.placement("never", ("a",), ("huge",)) == {}
    assert plans.placement("no task", ("a",), ("huge",)) == {}
