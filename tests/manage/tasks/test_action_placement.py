"""Where the functions of actions go that begin."""

from __future__ import annotations

import pytest

from poise.estimate.online import Estimate
from poise.manage.adaptation.situation import Situation
from poise.manage.observe.estimates import DemandEstimate
from poise.manage.tasks.action_placement import room_for_functions
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot


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
