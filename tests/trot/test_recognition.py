"""Faces that the world draws, and what the robot makes of them."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from tests.trot.alone import alone
from tests.trot.test_audition import Poses
from trot import eye_model
from trot.audition.head_turner import HeadTurner
from trot.household import PEOPLE
from trot.messages import Seen
from trot.packets import pack_view, unpack_angle, unpack_view
from trot.recognition.face_recogniser import FaceRecogniser
from trot.world.eye import Eye
from trot.world.simulation import Simulation
from trot.world.view import View


class Eyes:
    """Plays the camera in the head."""

    def __init__(self, *packets: bytes) -> None:
        self.packets = list(packets)

    def receive(self) -> list[bytes]:
        return self.packets


def seen(name: str, angle: float, distance: float | None, smallest: int) -> list[Seen]:
    """Return what the recogniser says of one picture, with the head at 0.5 rad."""
    started = alone(FaceRecogniser, {"smallest": smallest})
    picture = Eye(name).jpeg(angle, distance)
    started.component._eyes = Eyes(pack_view(7.0, 0.5, picture))
    started.component.look()
    return started.published["seen"]


@pytest.mark.parametrize("name", PEOPLE)
@pytest.mark.parametrize(("angle", "distance"), [(-0.35, 0.8), (0.0, 2.0), (0.2, 3.6)])
def test_recognises_who_is_in_view_and_where(
    name: str, angle: float, distance: float
) -> None:
    """A pixel is 0.2 degrees; sizes are 15 % apart."""
    (found,) = seen(name, angle, distance, smallest=20)
    assert (found.stamp, found.name) == (7.0, name)
    assert found.bearing == pytest.approx(0.5 + angle, abs=0.015)
    assert found.distance == pytest.approx(distance, rel=0.15)


def test_sees_nobody_where_nobody_is() -> None:
    assert seen("Anna", 0.0, None, smallest=20) == []


def test_the_smaller_recogniser_sees_half_as_far() -> None:
    """40 pixels are a face at 1.9 m."""
    (found,) = seen("Ben", 0.1, 1.5, smallest=40)
    assert found.name == "Ben"
    assert seen("Ben", 0.1, 3.0, smallest=40) == []


def test_a_picture_shows_a_face_as_large_as_it_is_near() -> None:
    """28 cm at 1 m are 78 pixels, 2 m away 39; straight ahead is the middle."""
    assert eye_model.pixels_of(0.28, 1.0) == pytest.approx(77.6, abs=0.1)
    assert eye_model.column(0.0) == eye_model.COLUMNS / 2
    assert eye_model.angle(eye_model.column(0.3)) == pytest.approx(0.3)
    nobody = Eye("Anna", 1).picture(0.0, None).astype(int)
    anna = Eye("Anna", 1).picture(0.0, 1.0).astype(int)
    changed = np.nonzero(np.abs(anna - nobody).max(axis=(0, 2)) > 40)[0]
    assert 55 < changed.max() - changed.min() < 78
    assert changed.mean() == pytest.approx(160, abs=4)


def test_walls_hide_people() -> None:
    """From the bedroom the chair is behind a wall; from the living room it is not."""
    assert not Simulation(start=(1.6, 2.8, 0.0)).sees(4.7, 2.1)
    assert Simulation(start=(3.6, 4.4, 0.0)).sees(4.7, 2.1)


def test_judges_names_of_people_who_are_in_view() -> None:
    """Anna sits 2 m ahead; a name counts from 1 s after she came into view."""
    view, simulation = View(seed=0), Simulation(start=(3.7, 4.4, 0.0))
    ahead = math.atan2(2.1 - 4.4, 4.7 - 3.7)
    assert view.result() == {"named": None}
    packet = view.picture(10.0, simulation, ahead, (4.7, 2.1))
    view.judge(10.5, "")
    view.judge(11.2, "Anna")
    view.judge(11.4, "Ben")
    assert view.result() == {"named": 0.5}
    view.picture(12.0, simulation, ahead + 1.5, (4.7, 2.1))
    view.judge(14.0, "")
    assert view.result() == {"named": 0.5}
    coded = np.frombuffer(unpack_view(packet)[2], np.uint8)
    assert np.asarray(cv2.imdecode(coded, 0)).shape == (240, 320)


class Neck:
    def __init__(self) -> None:
        self.angles: list[float] = []

    def send(self, packet: bytes) -> bool:
        self.angles.append(unpack_angle(packet))
        return True


def test_the_head_turns_to_a_face_while_nobody_speaks() -> None:
    """Robot at (1, 1) looking along y sees somebody 2 m to its left, at (-1, 1)."""
    poses = Poses(1.0, 1.0, math.pi / 2)
    turner = alone(HeadTurner, providers={"poses": poses})
    turner.component._neck = neck = Neck()
    turner.component.seen(Seen(0.0, "Anna", math.pi / 2, 2.0))
    turner.component.turn()
    poses.pose = (-1.0, 0.0, math.pi / 2)
    turner.component.turn()
    assert neck.angles == pytest.approx([math.pi / 2, 0.0], abs=1e-6)
