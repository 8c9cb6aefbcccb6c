from __future__ import annotations

import pytest

from tests.trot.drive import Drive

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow]


def test_reaches_the_goal_within_the_time_of_the_demo() -> None:
    """7.2 m at 0.5 to 0.6 m/s take about 13 s."""
    drive = Drive()
    drive.run(16.0)
    assert drive.simulation.goal_reached
    assert drive.simulation.collisions == 0
    assert 6.5 < drive.simulation.path_length < 8.0


def test_measures_how_old_pose_and_map_are_that_it_drives_by() -> None:
    """Of 9 cycles in 2 s, the first path comes after 2: at 0.6 s."""
    drive = Drive()
    drive.run(2.0)
    ages = drive.controller.measured
    assert len(ages["pose_age"]) == len(ages["map_age"]) == 7
    assert max(ages["pose_age"]) <= 0.1


@pytest.mark.parametrize("seed", range(4))
def test_reaches_the_goal_with_all_the_time_to_improve_commands(seed: int) -> None:
    drive = Drive(seed=seed, delay=0.1, effort=0.003)
    drive.run(18.0)
    assert drive.simulation.goal_reached


@pytest.mark.parametrize("start", [(4.33, 3.71, 3.0), (5.15, 2.57, 0.0)])
def test_gets_round_a_corner_that_it_stands_close_to(
    start: tuple[float, float, float],
) -> None:
    """The chair's or a door's corner lies between it and where its path leads."""
    drive = Drive(start=start)
    drive.run(16.0)
    assert drive.simulation.goal_reached


def test_stands_still_when_poses_are_300_ms_late() -> None:
    drive = Drive(delay=0.3)
    drive.run(20.0)
    assert not drive.simulation.goal_reached
    assert drive.simulation.distance_to_goal > 4.0


def test_misses_its_path_when_the_cycle_takes_600_ms() -> None:
    """Poses are 100 ms late here, well below what counts as blind."""
    drive = Drive(delay=0.1, period=0.6)
    drive.wheels.latency = 0.3
    drive.run(20.0)
    assert not drive.simulation.goal_reached
    assert drive.simulation.collisions > 0
