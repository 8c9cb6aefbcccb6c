"""Where the components of an alternative begin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import pytest
from msgspec import Struct

from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration import move
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot


class Reach(Struct):
    """Agents, some of which are out of reach."""

    lost: Mapping[str, float]

    def out_of_reach(self) -> Mapping[str, float]:
        return self.lost


class Running(Struct):
    """A robot that is up."""

    robot: Robot
    placed: Mapping[str, Incarnation]
    agents: Reach
    solve_steps: int = 1000


def alone(name: str, *only: str) -> Architecture:
    entry = ComponentEntry(name=name, demand={"cpu": 0.1}, only=only)
    return Architecture(name=name, function="see", components=(entry,))


@pytest.mark.parametrize(
    ("lost", "only", "where"),
    [
        ("", (), "a"),
        ("a", (), "b"),
        ("a", ("a", "b"), "b"),
        ("a", ("a",), "a"),  # it is said then that 'a' is out of reach
    ],
)
def test_it_begins_on_a_computer_that_is_in_reach(
    lost: str, only: tuple[str, ...], where: str
) -> None:
    old, new = alone("eye"), alone("lidar", *only)
    robot = Robot(
        name="seeing",
        computers=(
            Computer(name="a", capacity={"cpu": 1.0}),
            Computer(name="b", capacity={"cpu": 0.2}),
        ),
        architectures=(old, new),
    )
    placed = {"eye": Incarnation(component="eye", computer="b", epoch=1)}
    live: Any = Running(robot, placed, Reach(dict.fromkeys([lost], 1.0)))
    found = move._placement(cast("LiveRobot", live), old, new)
    assert found == {"lidar": where}
