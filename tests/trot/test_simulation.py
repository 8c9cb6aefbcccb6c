from __future__ import annotations

import math

import numpy as np
import pytest

from trot import home
from trot.laser_model import ANGLES, MAX_RANGE
from trot.world.simulation import BUMPER_HOLD, COMMAND_LIFE, STEP, Simulation

WALL = ((3.0, -9.0, 3.0, 9.0),)
"""A long wall; its face is 2.95 m from the y axis."""


def in_front_of_a_wall(x: float = 0.0) -> Simulation:
    return Simulation(start=(x, 0.0, 0.0), walls=WALL, furniture=())


def go(simulation: Simulation, seconds: float, speed: float, turn: float = 0) -> None:
    """Command the same every step."""
    for _ in range(round(seconds / STEP)):
        simulation.command(speed, turn)
        simulation.step()


def beam(angle: float) -> int:
    return int(np.abs(ANGLES - angle).argmin())


def test_measures_the_distance_to_a_wall() -> None:
    """Straight ahead 2.95 m; 45 degrees aside 2.95 / cos 45 = 4.17 m."""
    ranges = in_front_of_a_wall().scan()
    assert ranges[beam(0.0)] == pytest.approx(2.95, abs=0.06)
    aside = beam(math.pi / 4)
    expected = 2.95 / math.cos(ANGLES[aside])
    assert ranges[aside] == pytest.approx(expected, abs=0.06)


def test_reads_the_longest_range_where_nothing_is() -> None:
    ranges = in_front_of_a_wall().scan()
    assert ranges[0] == pytest.approx(MAX_RANGE, abs=0.06)


def test_sees_furniture_too() -> None:
    """The box begins 1 m ahead, nearer than the wall."""
    box = ((1.0, -0.2, 1.5, 0.2),)
    simulation = Simulation(start=(0, 0, 0), walls=WALL, furniture=box)
    assert simulation.scan()[beam(0.0)] == pytest.approx(1.0, abs=0.06)


def test_drives_as_fast_as_commanded() -> None:
    """0.6 m/s after 0.5 s of 1.2 m/s2: 0.15 m, and 0.9 m in another 1.5 s."""
    simulation = in_front_of_a_wall()
    go(simulation, 2.0, 0.6)
    x, y, heading = simulation.pose
    assert x == pytest.approx(1.05, abs=0.02)
    assert (y, heading) == pytest.approx((0.0, 0.0), abs=1e-3)


def test_turns_as_fast_as_commanded() -> None:
    """1 rad/s after 0.25 s of 4 rad/s2: 0.125 rad, and 0.75 in another 0.75 s."""
    simulation = in_front_of_a_wall()
    go(simulation, 1.0, 0.0, 1.0)
    assert simulation.pose[2] == pytest.approx(0.875, abs=0.05)


def test_stops_when_no_command_comes_any_more() -> None:
    """0.6 m/s for the command's life of 0.5 s: 0.3 m, and 0.15 m to brake."""
    simulation = in_front_of_a_wall()
    go(simulation, 1.0, 0.6)
    last = simulation.pose[0]
    for _ in range(round((COMMAND_LIFE + 1.0) / STEP)):
        simulation.step()
    assert simulation.pose[0] - last == pytest.approx(0.45, abs=0.03)
    stopped = simulation.pose
    simulation.step()
    assert simulation.pose == pytest.approx(stopped, abs=1e-3)


def test_a_wall_stops_the_base() -> None:
    """Its centre gets no nearer than the radius: 2.95 - 0.25 = 2.7 m."""
    simulation = in_front_of_a_wall(x=2.4)
    go(simulation, 1.5, 0.6)
    assert simulation.collisions == 1
    assert simulation.pose[0] == pytest.approx(2.7, abs=0.03)


def test_after_a_bump_the_wheels_stand_still_and_then_go_again() -> None:
    simulation = in_front_of_a_wall(x=2.65)
    go(simulation, 0.5, 0.6)
    assert simulation.collisions == 1
    bumped = simulation.pose[0]
    go(simulation, BUMPER_HOLD - 0.4, -0.6)
    assert simulation.pose[0] == pytest.approx(bumped, abs=0.03)
    go(simulation, 1.0, -0.6)
    assert simulation.pose[0] < bumped - 0.2


def test_odometry_drifts_by_about_a_hundredth() -> None:
    simulation = Simulation(start=(0, 0, 0), walls=(), furniture=())
    go(simulation, 10.0, 0.5)
    counted, driven = simulation.odometry[1], simulation.pose[0]
    assert counted / driven == pytest.approx(1.01, abs=0.01)


def test_the_goal_is_reached_within_a_quarter_of_a_metre() -> None:
    x, y = home.GOAL
    assert Simulation(start=(x - 0.24, y, 0)).goal_reached
    assert not Simulation(start=(x - 0.26, y, 0)).goal_reached


def test_the_same_seed_gives_the_same_scan() -> None:
    np.testing.assert_array_equal(Simulation(3).scan(), Simulation(3).scan())
