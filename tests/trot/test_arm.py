from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from poise.runtime.component.ports import Published
from tests.trot.alone import VirtualClock, alone
from trot.arm import arm_model
from trot.arm.arm_controller import ArmController
from trot.arm.arm_model import ArmModel
from trot.arm.camera_model import pixel, place
from trot.arm.grasp_planner import GraspPlanner
from trot.arm.object_detector import find_cup
from trot.arm.trajectory_planner import (
    SPEED,
    STEP,
    STRIDE,
    TrajectoryPlanner,
    WayPlanner,
    timed,
)
from trot.messages import Cup, Joints, Order, Trajectory
from trot.packets import pack_arm, unpack_arm
from trot.world.camera import Camera
from trot.world.simulation import STEP as WORLD_STEP
from trot.world.simulation import Simulation

REST = np.array(arm_model.REST)


def grip(side: str, above: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([*arm_model.PLACES[side], arm_model.TRAY_HEIGHT + above])


def test_the_resting_hand_is_where_the_links_say() -> None:
    """Angles add up to 0, -1.9, 0.2 and 1.57 rad; links of 24, 20 and 11 cm follow."""
    place, axis = ArmModel().hand(REST)
    reach = 0.24 * math.cos(1.9) + 0.2 * math.cos(0.2) + 0.11 * math.cos(1.57)
    height = 0.24 * math.sin(1.9) - 0.2 * math.sin(0.2) - 0.11 * math.sin(1.57)
    assert place == pytest.approx((-0.15 + reach, 0, 0.62 + height), abs=1e-3)
    assert axis == pytest.approx((0, 0, -1), abs=1e-2)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("above", [0.055, 0.2])
def test_kinematics_brings_the_hand_over_a_cup(side: str, above: float) -> None:
    arm = ArmModel()
    target = grip(side, above)
    angles = arm.solve(target, REST)
    assert arm.off(target, angles) < 0.001
    assert not arm.touches(angles)


def test_knows_what_the_arm_touches() -> None:
    """The bottle is 16 cm high; a held cup reaches 3 cm below where it is gripped."""
    arm, carrying = ArmModel(), ArmModel(carries=True)
    assert not arm.touches(REST)
    x, y = arm_model.TRAY
    in_bottle = arm.solve(np.array([x, y, arm_model.TRAY_HEIGHT + 0.1]), REST)
    assert arm.touches(in_bottle)
    over_bottle = arm.solve(np.array([x, y, arm_model.TRAY_HEIGHT + 0.2]), REST)
    assert not arm.touches(over_bottle)
    assert carrying.touches(over_bottle)


def test_goes_round_the_bottle() -> None:
    arm = ArmModel(carries=True)
    start = arm.solve(grip("left", 0.1), REST)
    goal = arm.solve(grip("right", 0.1), REST)
    between = np.linspace(start, goal, 30)
    assert any(arm.touches(posture) for posture in between)
    way = WayPlanner(arm, shortcuts=50).way(start, goal)
    assert way is not None
    assert (way[0] == start).all()
    assert (way[-1] == goal).all()
    for one, other in pairwise(way):
        steps = int(np.abs(other - one).max() / STRIDE) + 2
        between = np.linspace(one, other, steps)
        assert not any(arm.touches(posture) for posture in between)


def test_finds_no_way_into_the_bottle() -> None:
    arm = ArmModel()
    x, y = arm_model.TRAY
    inside = arm.solve(np.array([x, y, arm_model.TRAY_HEIGHT + 0.1]), REST)
    assert not WayPlanner(arm)._is_free(REST, inside)


def test_a_trajectory_is_no_quicker_than_the_joints() -> None:
    angles = timed(np.array([np.zeros(6), np.full(6, 1.0)]))
    speeds = np.abs(np.diff(angles, axis=0)).max(axis=1) / STEP
    assert angles[0] == pytest.approx(np.zeros(6))
    assert angles[-1] == pytest.approx(np.ones(6))
    assert speeds.max() < 1.1 * SPEED
    assert speeds[0] < 0.2 * SPEED


def test_the_camera_sees_a_point_where_it_is() -> None:
    """The tray's middle is in the picture's; 10 cm at 90 cm away are 100 pixels."""
    assert pixel(*arm_model.TRAY, 0.4) == pytest.approx((320, 240))
    x, y = arm_model.TRAY
    assert pixel(x, y + 0.1, 0.4) == pytest.approx((320, 140))
    assert place(320, 140, 0.4) == pytest.approx((x, y + 0.1))


@pytest.mark.parametrize("where", [(0.09, 0.12), (0.09, -0.12), (0.03, 0.1)])
def test_sees_the_cup(where: tuple[float, float]) -> None:
    middle = np.array([*where, arm_model.TRAY_HEIGHT + arm_model.CUP_HEIGHT / 2])
    found = find_cup(Camera().picture(middle, []))
    assert found == pytest.approx(where, abs=0.006)


def test_sees_no_cup_where_none_is() -> None:
    away = np.array([5.0, 5.0, 0.5])
    assert find_cup(Camera().picture(away, [])) is None


def planner() -> tuple[GraspPlanner, list[str]]:
    """Return a grasp planner that sees the cup on the left, and where it reaches."""
    started = alone(GraspPlanner)
    sides: list[str] = []

    def note(reach: object) -> None:
        place, _ = ArmModel().hand(reach.angles.astype(float))  # type: ignore[attr-defined]
        sides.append("left" if place[1] > 0 else "right")

    started.component.reach = Published(note)
    started.component.cup(Cup(0.0, *arm_model.PLACES["left"]))
    return started.component, sides


def test_grasps_then_places_on_the_other_side() -> None:
    grasping, sides = planner()
    for done in range(6):
        grasping.joints(Joints(0.0, REST.astype(np.float32), done))
    assert sides == ["left"] * 3 + ["right"] * 3


def test_does_not_begin_before_the_last_reach_is_done() -> None:
    grasping, sides = planner()
    grasping.order(Order(0.0, "right"))
    for _ in range(3):
        grasping.joints(Joints(0.0, REST.astype(np.float32), 0))
    assert sides == ["left"]


def test_in_a_task_it_says_that_the_cup_is_placed_and_rests() -> None:
    """The camera sees the cup where it was put, or 10 cm beside: then it goes on."""
    for off, placed in ((0.01, True), (0.1, False)):
        grasping, sides = planner()
        ends: list[bool] = []
        grasping.placed = Published(ends.append)
        grasping.begin("take")
        for done in range(6):
            grasping.joints(Joints(0.0, REST.astype(np.float32), done))
        x, y = arm_model.PLACES["right"]
        grasping.cup(Cup(0.1, x, y + off))
        for _ in range(2):
            grasping.joints(Joints(0.2, REST.astype(np.float32), 6))
        assert ends == [placed]
        assert len(sides) == (6 if placed else 7)


class Motors:
    """Takes commands in the place of the device."""

    def __init__(self, simulation: Simulation) -> None:
        self._hand = simulation.hand

    def receive(self) -> list[bytes]:
        return [pack_arm(self._hand.angles, closed=self._hand.is_closed)]

    def send(self, packet: bytes) -> bool:
        angles, closed = unpack_arm(packet)
        self._hand.move(angles, closed=closed)
        return True


def test_closes_the_hand_at_the_end_of_a_trajectory() -> None:
    simulation = Simulation()
    controller = alone(ArmController).component
    controller._motors = Motors(simulation)
    held = []
    controller.joints = Published(lambda joints: held.append(joints.done))
    target = REST + np.array([0.2, 0, 0, 0, 0, 0])
    way = np.linspace(REST, target, 10).astype(np.float32)
    controller.trajectory(Trajectory(0.0, 7, way, closes=True))
    for _ in range(60):
        controller.control()
        simulation.step()
    assert held[0] == 0
    assert held[-1] == 7
    assert controller._closed
    assert simulation.hand.angles == pytest.approx(target, abs=0.03)


@pytest.mark.slow
def test_brings_the_cup_to_the_other_side_and_back() -> None:
    """Camera, grasp, way, motors and physics together; a round takes 8 s."""
    clock, simulation, camera = VirtualClock(), Simulation(), Camera()
    grasp = alone(GraspPlanner, clock=clock).component
    way = alone(TrajectoryPlanner, {"shortcuts": 50}, clock=clock).component
    controller = alone(ArmController, clock=clock).component
    controller._motors = Motors(simulation)
    grasp.reach = Published(way.reach)
    way.trajectory = Published(controller.trajectory)

    def told(joints: Joints) -> None:
        grasp.joints(joints)
        way.joints(joints)

    controller.joints = Published(told)
    for step in range(round(10 / WORLD_STEP)):
        if step % 5 == 0:
            hand = simulation.hand
            if found := find_cup(camera.picture(hand.cup[0], hand.points)):
                grasp.cup(Cup(clock.now(), *found))
        controller.control()
        simulation.step()
        clock.time = simulation.now
    assert simulation.hand.placed >= 2
    assert simulation.hand.dropped == 0
