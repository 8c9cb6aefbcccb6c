"""Each component does its job on inputs whose right answer is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from poise.clock import Stamp
from sorter import arm_model, cell
from sorter.arm_controller import TRUSTED, ArmController
from sorter.belt_predictor import SPEEDS, BeltPredictor
from sorter.camera_driver import BELT, CameraDriver
from sorter.detector import find
from sorter.device import Device
from sorter.gripper import Gripper
from sorter.inspector import bank, scratched
from sorter.messages import Detections, Grip, Guard, Motion, Tracks
from sorter.safety_monitor import nearest
from sorter.tracker import Tracker
from sorter.world.scene import Scene, Thing
from sorter.world.sensors import Sensors
from tests.trot.alone import VirtualClock, alone

RED = Thing(x=-0.3, y=0.33, colour="red", round=True, angle=0.0, scratch=None)
BLUE = Thing(x=-0.6, y=0.38, colour="blue", round=False, angle=0.4, scratch=0.7)


class Port:
    """Plays a device: gives its packets, the last one for ever; keeps what it gets."""

    def __init__(self, *packets: tuple[object, ...]) -> None:
        self._packets = list(packets)
        self.sent: list[object] = []

    def newest(self) -> tuple[object, ...]:
        return self._packets.pop(0) if len(self._packets) > 1 else self._packets[0]

    def send(self, value: object) -> None:
        self.sent.append(value)


def picture(*things: Thing) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return what the camera driver makes of a scene: in colour, and in grey."""
    scene = Scene(0)
    scene.things = list(things)
    driver = alone(CameraDriver)
    driver.component._camera = Port((1.0, Sensors(3).picture(scene)))
    for _ in range(2):
        driver.component.read()
    return driver.published["picture"][0].pixels, driver.published["view"][0].pixels


def test_the_camera_driver_takes_the_lamps_colour_out() -> None:
    colour, grey = picture()
    assert np.median(colour.reshape(-1, 3), axis=0) == pytest.approx([BELT] * 3, abs=1)
    assert (colour.shape, grey.shape) == ((300, 400, 3), (300, 400))


@pytest.mark.parametrize(("scale", "exact"), [(1.0, 0.003), (0.4, 0.006)])
def test_the_detector_sees_where_and_of_which_colour_objects_are(
    scale: float, exact: float
) -> None:
    colour, _ = picture(RED, BLUE)
    places, colours = find(colour, scale)
    seen = sorted(zip(colours, places.tolist(), strict=True))
    assert [name for name, _ in seen] == ["blue", "red"]
    assert seen[0][1] == pytest.approx([BLUE.x, BLUE.y], abs=exact)
    assert seen[1][1] == pytest.approx([RED.x, RED.y], abs=exact)


def test_the_detector_leaves_out_what_is_not_wholly_in_the_picture() -> None:
    """Half of an object has its middle where the object has not."""
    half = replace(RED, x=-0.05)
    assert find(picture(half)[0])[1] == []


def test_the_inspector_sees_scratches_and_no_others() -> None:
    _, grey = picture(RED, BLUE)
    (place,) = scratched(grey, bank(8)).tolist()
    assert place == pytest.approx([BLUE.x, BLUE.y], abs=0.006)


def test_the_tracker_follows_what_the_camera_sees_no_more() -> None:
    """Two objects 0.3 m apart ride at 0.2 m/s; the first one leaves the view at 1 s."""
    tracker = alone(Tracker)
    for number in range(21):
        at = number / 10
        first, second = -0.3 + 0.2 * at, -0.6 + 0.2 * at
        places = [[first, 0.35], [second, 0.4]] if at <= 1 else [[second, 0.4]]
        colours = ["red", "blue"][-len(places) :]
        seen = Detections(Stamp(at), np.array(places, np.float32), colours)
        tracker.component.detections(seen)
    last = tracker.published["tracks"][-1]
    assert (last.numbers, last.colours) == ([1, 2], ["red", "blue"])
    assert last.speed == pytest.approx(0.2, abs=0.005)
    np.testing.assert_allclose(last.places, [[0.1, 0.35], [-0.2, 0.4]], atol=0.005)


def test_a_tracker_that_moves_goes_on_where_it_was() -> None:
    before, after = alone(Tracker), alone(Tracker)
    places = np.array([[-0.3, 0.35]], np.float32)
    before.component.detections(Detections(Stamp(1.0), places, ["red"]))
    after.component.restore(before.component.snapshot())
    for each in (before, after):
        each.component.detections(Detections(Stamp(1.1), places + 0.02, ["red"]))
    one, other = before.published["tracks"][-1], after.published["tracks"][-1]
    np.testing.assert_array_equal(one.places, other.places)
    assert (one.numbers, one.speed) == (other.numbers, other.speed)


def test_the_belt_is_predicted_as_it_gains_speed() -> None:
    """At 0.02 m/s^2 from 0.2 m/s: in a second 0.2 + 0.01 m."""
    clock = VirtualClock()
    predictor = alone(BeltPredictor, clock=clock).component
    assert predictor.travel(Stamp(0.0), [1.0]) == []
    nothing = np.zeros((0, 2), np.float32)
    for number in range(SPEEDS):
        at = number / 10
        speed = 0.2 + 0.02 * (at - 1.4)
        predictor.tracks(Tracks(Stamp(at), speed, [], nothing, []))
    clock.time = 1.9
    assert predictor.travel(Stamp(1.4), [0.5]) == pytest.approx([0.21])


@pytest.mark.parametrize("target", [*cell.BINS.values(), (0.0, 0.29), (0.32, 0.41)])
def test_the_hand_reaches_bins_and_zone_and_points_down(
    target: tuple[float, float],
) -> None:
    for height in (cell.ON_BELT, cell.HOVER):
        angles = arm_model.solve((*target, height), arm_model.REST)
        there = [*target, height, -np.pi / 2]
        assert arm_model.hand(angles) == pytest.approx(there, abs=0.005)


def test_the_arm_follows_the_motion_only_while_the_guard_says_so() -> None:
    """From 1 to 3 rad in 0.06 s: 2 rad after 0.03 s."""
    clock = VirtualClock()
    arm = alone(ArmController, clock=clock).component
    arm._arm = motors = Port(([1.0] * 4,))
    arm.motion(
        Motion(Stamp(0.0), np.array([[1.0] * 4, [2.0] * 4, [3.0] * 4], np.float32))
    )
    arm.control()
    arm.guard(Guard(Stamp(0.0), clear=True))
    clock.time = 0.03
    arm.control()
    arm.guard(Guard(Stamp(0.03), clear=False))
    arm.control()
    arm.guard(Guard(Stamp(0.03), clear=True))
    clock.time = 0.03 + TRUSTED + 0.01
    arm.control()
    stands, moves = [1.0] * 4, [2.0] * 4
    assert motors.sent == [stands, pytest.approx(moves), stands, stands]


def test_the_hand_closes_at_its_moment() -> None:
    clock = VirtualClock()
    gripper = alone(Gripper, clock=clock)
    gripper.component._hand = hand = Port((False,), (True,))
    gripper.component.grip(Grip(Stamp(0.0), 0.1, closed=True))
    gripper.component.control()
    clock.time = 0.11
    gripper.component.control()
    assert hand.sent == [False, True]
    assert gripper.published["held"] == [True]


def test_the_scanner_sees_a_person_and_no_noise() -> None:
    background = np.full(cell.BEAMS, 5.0)
    scan = background.copy()
    scan[10:12] = 1.0  # two beams of noise
    scan[100:120] = 1.4
    scan[200:230] = 2.0
    assert nearest(scan, background) == 1.4
    assert nearest(background, background) == np.inf


@pytest.mark.slow
def test_a_device_that_is_away_is_no_error(tmp_path: Path) -> None:
    device = Device(str(tmp_path / "arm.sock"))
    assert device.newest() is None
    device.send([0.0] * 4)
