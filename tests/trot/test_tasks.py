"""What ends the actions of tasks, and what the world says came of them."""

from __future__ import annotations

import math
from typing import Any

import pytest

import poise
from poise.clock import Stamp
from tests.trot.alone import alone
from tests.trot.test_audition import Poses
from tests.trot.test_robot import FILE
from trot import home
from trot.interaction.dialogue_manager import DialogueManager
from trot.messages import Map, Pose, Seen
from trot.navigator import grid
from trot.navigator.follower import BEHIND, LED, LOST, STANDS, Follower
from trot.navigator.path_planner import PathPlanner
from trot.world.__main__ import FOLLOWS
from trot.world.errands import Errands, tasks
from trot.world.simulation import Simulation
from trot.world.walk import LENGTH, ROUTE, Walk

AT = Pose(Stamp(0.0), 1.0, 1.0, math.pi / 2)
"""Looks along y."""


def test_a_follower_stays_behind() -> None:
    """Someone is 3 m ahead, at (1, 4)."""
    follower = Follower()
    assert follower.goal(5.0) is None
    follower.note(AT, Seen(5.0, "Ben", 0.0, 3.0))
    assert follower.goal(5.1) == pytest.approx((1.0, 4.0 - BEHIND))
    assert follower.goal(5.1 + LOST) == pytest.approx((1.0, 4.0)), "out of view"
    assert not follower.is_there(AT, now=99.0)


def test_has_followed_when_who_led_stands_near() -> None:
    follower = Follower()
    follower.note(AT, Seen(5.0, "Ben", 0.0, 1.0))
    follower.note(AT, Seen(6.0, "Ben", 0.0, 1.0 + LED + 0.1))
    near = Pose(Stamp(0.0), 1.0, 2.0, math.pi / 2)
    assert not follower.is_there(AT, now=6.0 + STANDS + 0.1), "too far away"
    assert not follower.is_there(near, now=6.0 + STANDS - 0.1), "still walks"
    assert follower.is_there(near, now=6.0 + STANDS + 0.1)


class Walls:
    """The map of the home without furniture."""

    def latest_map(self) -> Map:
        cells = (grid.walls() * 100).astype("int8")
        return Map(Stamp(0.0), cells)


def test_says_that_it_arrived_where_the_action_leads_to() -> None:
    """At the second plan within 20 cm of the kitchen; not after the bedroom."""
    poses, goals = Poses(*home.START), {"go": list(home.GOAL), "follow": "person"}
    planner = alone(
        PathPlanner, {"goals": goals}, providers={"poses": poses, "maps": Walls()}
    )
    planner.component.begin("go")
    planner.component.plan()
    assert planner.published["path"][0].points[-1] == pytest.approx(home.GOAL, abs=0.05)
    poses.pose = (home.GOAL[0] - 0.15, home.GOAL[1], 0.0)
    planner.component.plan()
    assert planner.published["arrived"] == []
    planner.component.plan()
    assert planner.published["arrived"] == [True]
    planner.component.begin("follow")
    planner.component.plan()
    assert planner.published["arrived"] == [True]
    planner.component.seen(Seen(1.0, "Ben", math.pi / 2, 2.0))
    planner.component.plan()
    x, y = planner.published["path"][-1].points[-1]
    assert (x, y) == pytest.approx((poses.pose[0], home.GOAL[1] + 1.1), abs=0.05)


def test_says_what_the_robot_is_going_to_do() -> None:
    """The person waits for these words."""
    dialogue = alone(DialogueManager)
    dialogue.component.begin("offer")
    assert dialogue.published["sentence"][0].text.startswith(FOLLOWS)
    assert dialogue.published["said"] == [True]


def test_the_person_leads_only_when_asked() -> None:
    """4.2 m at 0.35 m/s take 12 s."""
    walk = Walk()
    walk.step(1.0)
    assert walk.place == ROUTE[0]
    walk.is_leading = True
    walk.step(2.0)
    assert walk.place == pytest.approx((4.7 + 0.7, 2.1))
    assert walk.is_walking
    walk.step(20.0)
    assert (walk.place, walk.walked) == (ROUTE[-1], LENGTH)
    assert not walk.is_walking


def at(errands: Errands, simulation: Simulation, x: float, y: float) -> None:
    simulation._data.qpos[:2] = x, y
    errands.look()


def test_a_cup_from_the_kitchen_is_served() -> None:
    simulation, walk = Simulation(), Walk()
    errands = Errands(simulation, walk)
    at(errands, simulation, 4.0, 2.2)
    at(errands, simulation, *home.GOAL)
    at(errands, simulation, 4.0, 2.2)
    assert errands.values()["serve_beverage"]["served_after"] is None
    at(errands, simulation, *home.GOAL)
    simulation.hand.placed += 1
    at(errands, simulation, *home.GOAL)
    simulation.now = 33.0
    at(errands, simulation, 4.0, 2.2)
    assert errands.values()["serve_beverage"]["served_after"] == 33.0


GOOD: dict[str, dict[str, Any]] = {
    "serve_beverage": {"served_after": 33.0, "cups_dropped": 0},
    "follow_person": {"walked": LENGTH, "gap_mean": 1.4, "gap_at_end": 1.0},
}
SHOWN = {"recommendation_seconds": 0.5, "good_recommendations": 0.8}


def success(values: dict[str, dict[str, Any]], shown: dict[str, float]) -> list[str]:
    return [each["name"] for each in tasks(values, shown) if each["success"]]


def test_an_evening_is_good_when_all_its_tasks_are() -> None:
    assert len(success(GOOD, SHOWN)) == 4
    late = {**GOOD, "follow_person": {**GOOD["follow_person"], "gap_at_end": 3.0}}
    assert success(late, SHOWN) == ["serve_beverage", "recommend_tv"]
    assert success(GOOD, {**SHOWN, "good_recommendations": 0.2}) == [
        *("serve_beverage", "follow_person"),
    ]
    found = {each["name"]: each["values"] for each in tasks(GOOD, SHOWN)}
    assert found["serve_beverage"]["served_after"] == {"value": 33.0, "unit": "s"}


@pytest.mark.slow
def test_each_task_has_its_phases() -> None:
    robot = poise.load(FILE)
    names = [task.name for task in robot.tasks]
    counts = {name: len(poise.place(robot, name).phases) for name in names}
    assert counts == {
        "serve": 1,
        "serve_beverage": 3,
        "follow_person": 3,
        "recommend_tv": 1,
        "evening": 6,
    }
