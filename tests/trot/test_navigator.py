from __future__ import annotations

import math

import numpy as np
import pytest

from poise.clock import Stamp
from tests.trot.alone import VirtualClock, alone
from trot import home
from trot.laser_model import BEAMS, MAX_RANGE
from trot.messages import LocatedScan, Map, Path, Pose, Scan
from trot.navigator import grid
from trot.navigator.localiser import Localiser
from trot.navigator.mapper import Mapper, occupied
from trot.navigator.motion_controller import BLIND, MotionController, make_for
from trot.navigator.path_planner import way
from trot.navigator.surroundings import Surroundings
from trot.packets import unpack_command
from trot.world.simulation import Simulation

NOTHING = np.zeros((grid.SIZE, grid.SIZE), np.int8)


def walled() -> grid.Cells:
    return np.where(grid.walls(), np.int8(100), np.int8(0))


def at(cells: grid.Cells, x: float, y: float) -> int:
    return int(cells[grid.row(np.array(y)), grid.column(np.array(x))])


def odometry_of(simulation: Simulation) -> Pose:
    at, x, y, heading = simulation.odometry
    return Pose(Stamp(at), x, y, heading)


def test_distance_grows_from_an_obstacle() -> None:
    """One occupied cell: 1 cell aside 5 cm, a diagonal 7.07 cm, far off the limit."""
    cells = np.zeros((41, 41), bool)
    cells[20, 20] = True
    field = grid.distance(cells, 0.5, 0.05)
    assert field[20, 21] == pytest.approx(0.05)
    assert field[21, 21] == pytest.approx(0.05 * math.sqrt(2))
    assert field[20, 26] == pytest.approx(0.3)
    assert field[0, 0] == pytest.approx(0.5)


@pytest.mark.slow
def test_localiser_finds_itself_from_a_wrong_start() -> None:
    """It believes to be 25 cm and 0.15 rad away from where it is."""
    x, y, heading = home.START
    simulation = Simulation()
    wrong = [x + 0.2, y - 0.15, heading + 0.15]
    started = alone(Localiser, {"start": wrong, "particles": 600})
    for _ in range(40):
        simulation.step()
        odometry = odometry_of(simulation)
        started.component.scan(Scan(Stamp(simulation.now), simulation.scan(), odometry))
    pose = started.component.latest_pose()
    assert math.dist((pose.x, pose.y), (x, y)) < 0.08
    assert abs(pose.heading - heading) < 0.05
    assert pose.stamp == Stamp(simulation.now)


def test_a_new_localiser_goes_on_where_the_old_one_was() -> None:
    old, new = alone(Localiser).component, alone(Localiser).component
    simulation = Simulation()
    old.scan(Scan(Stamp(0.0), simulation.scan(), odometry_of(simulation)))
    new.restore(old.snapshot())
    assert new.latest_pose() == old.latest_pose()
    np.testing.assert_array_equal(new.snapshot().particles, old.snapshot().particles)


def test_mapper_knows_the_walls_before_any_scan() -> None:
    seen = alone(Mapper).component.latest_map()
    assert at(seen.cells, 3.0, 1.0) > grid.OCCUPIED
    assert at(seen.cells, 3.0, 4.4) < grid.OCCUPIED


def test_mapper_adds_what_the_laser_sees() -> None:
    """All beams end 1 m from (1.5, 3): there is something, and nothing before it."""
    mapper = alone(Mapper).component
    ranges = np.full(BEAMS, 1.0, np.float32)
    mapper.located(LocatedScan(Pose(Stamp(7.0), 1.5, 3.0, 0.0), ranges))
    seen = mapper.latest_map()
    assert seen.stamp == Stamp(7.0)
    assert max(at(seen.cells, x, 3.02) for x in (2.46, 2.52)) >= grid.OCCUPIED
    assert at(seen.cells, 2.0, 3.02) < 0


def test_mapper_takes_no_range_for_an_obstacle() -> None:
    mapper = alone(Mapper).component
    ranges = np.full(BEAMS, MAX_RANGE, np.float32)
    before = occupied(mapper.latest_map().cells).sum()
    mapper.located(LocatedScan(Pose(Stamp(0.0), 1.5, 3.0, 0.0), ranges))
    assert occupied(mapper.latest_map().cells).sum() <= before


def test_plans_straight_where_nothing_is() -> None:
    points = way(NOTHING, (1.0, 1.0), (4.0, 1.0))
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert length == pytest.approx(3.0, abs=0.1)


def test_plans_through_both_doors() -> None:
    """It crosses x = 3 at y of 3.9 to 4.9, and x = 5.5 at y of 1.6 to 2.6."""
    points = way(walled(), home.START[:2], home.GOAL)
    for wall, low, high in ((3.0, 3.9, 4.9), (5.5, 1.6, 2.6)):
        y = points[np.abs(points[:, 0] - wall).argmin(), 1]
        assert low + home.ROBOT_RADIUS < y < high - home.ROBOT_RADIUS
    assert math.dist(points[-1], home.GOAL) < 0.1


def test_refuses_to_plan_through_a_wall() -> None:
    cells = walled()
    cells[:, grid.column(np.array(3.0))] = 100
    assert len(way(cells, home.START[:2], home.GOAL)) == 0


def test_plans_out_of_a_tight_spot() -> None:
    """15 cm from a wall, where the robot does not fit, the way leads away."""
    points = way(walled(), (0.2, 3.0), (2.0, 3.0))
    assert len(points) > 0


class Answers:
    """Tells the same pose and map all the time."""

    def __init__(self, pose: Pose, cells: grid.Cells) -> None:
        self.pose = pose
        self.map = Map(pose.stamp, cells)
        self.sent: list[tuple[float, float]] = []

    def latest_pose(self) -> Pose:
        return self.pose

    def latest_map(self) -> Map:
        return self.map

    def send(self, packet: bytes) -> bool:
        command = unpack_command(packet)
        assert command is not None
        self.sent.append(command)
        return True


def command(
    cells: grid.Cells, target: tuple[float, float], age: float
) -> tuple[float, float]:
    """Return what the controller does at (2, 2), heading along x."""
    answers = Answers(Pose(Stamp(0.0), 2.0, 2.0, 0.0), cells)
    clock = VirtualClock()
    clock.time = age
    asked = {"poses": answers, "maps": answers}
    controller = alone(MotionController, clock=clock, providers=asked).component
    controller._wheels = answers
    controller.path(Path(Stamp(0.0), np.array([(2, 2), target], np.float32)))
    controller.cycle()
    return answers.sent[-1]


def test_drives_towards_its_path() -> None:
    speed, turn = command(NOTHING, (3.0, 2.0), age=0.1)
    assert speed > 0.4
    assert abs(turn) < 0.3


def test_turns_towards_its_path() -> None:
    _, turn = command(NOTHING, (2.0, 3.0), age=0.1)
    assert turn > 0.5


def test_does_not_drive_into_an_obstacle() -> None:
    """A wall 40 cm ahead: 15 cm from the hull."""
    cells = NOTHING.copy()
    cells[:, grid.column(np.array(2.4))] = 100
    speed, _ = command(cells, (3.0, 2.0), age=0.1)
    assert speed <= 0.1


def test_makes_for_what_it_can_reach_straight() -> None:
    """The path leads 0.4 m ahead and then left, behind the end of a wall."""
    cells = NOTHING.copy()
    xs, ys = np.linspace(1.0, 2.1, 30), np.linspace(2.3, 2.4, 3)
    cells[grid.row(ys)[:, None], grid.column(xs)] = 100
    pose = Pose(Stamp(0.0), 2.0, 2.0, 0.0)
    path = np.array(
        [(2, 2), (2.2, 2), (2.4, 2), (2.4, 2.2), (2.4, 2.4), (2.2, 2.7)], np.float32
    )
    target = make_for(path, pose, Surroundings(pose, Map(Stamp(0.0), cells)))
    assert target is not None
    assert target[0] == pytest.approx(2.4)
    free = make_for(path, pose, Surroundings(pose, Map(Stamp(0.0), NOTHING)))
    assert free is not None
    assert free.tolist() == pytest.approx([2.2, 2.7])


def test_does_not_drive_blind() -> None:
    assert command(NOTHING, (3.0, 2.0), age=BLIND + 0.05) == (0.0, 0.0)
