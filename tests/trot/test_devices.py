"""Components that read or write a device: what they make of its packets."""

from __future__ import annotations

import numpy as np
import pytest

from tests.trot.alone import VirtualClock, alone
from trot.arm import arm_model
from trot.arm.object_detector import ObjectDetector
from trot.audition.microphone_array import MicrophoneArray
from trot.interaction.face_animator import face
from trot.interaction.screen_display import FORGETS, ScreenDisplay
from trot.laser_model import BEAMS, MAX_RANGE
from trot.messages import Image, Seen, Sentence
from trot.navigator.laser_scanner import LaserScanner
from trot.packets import (
    MICROPHONES,
    SOUND_SAMPLES,
    Screen,
    pack_odometry,
    pack_picture,
    pack_ranges,
    pack_sound,
    unpack_screen,
)
from trot.world.camera import Camera


class Port:
    """Plays a device: gives packets once, and keeps what it gets."""

    def __init__(self, *packets: bytes) -> None:
        self.packets = list(packets)
        self.screens: list[Screen] = []

    def receive(self, **_: float) -> list[bytes]:
        found, self.packets = self.packets, []
        return found

    def send(self, packet: bytes) -> bool:
        self.screens.append(unpack_screen(packet))
        return True


def test_a_scan_goes_with_the_odometry_of_its_moment() -> None:
    """Counted at 4.9, 5.0 and 5.1 s; the newest of two scans is of 5.02 s."""
    scanner = alone(LaserScanner)
    old, new = np.full(BEAMS, 1.0, np.float32), np.full(BEAMS, 9.0, np.float32)
    scanner.component._laser = Port(pack_ranges(4.92, old), pack_ranges(5.02, new))
    counted = [pack_odometry((at, at / 10, 2.0, 0.5)) for at in (4.9, 5.0, 5.1)]
    scanner.component._wheels = Port(*counted)
    scanner.component.read()
    scanner.component.read()
    (scan,) = scanner.published["scan"]
    assert scan.stamp.at == pytest.approx(5.02)
    assert scan.odometry.x == pytest.approx(0.5)
    assert (scan.ranges == MAX_RANGE).all()


def test_the_microphones_have_no_offset() -> None:
    """A wave of 100 around 40 becomes one around 0."""
    wave = 100 * np.resize([1, -1], (MICROPHONES, SOUND_SAMPLES)).astype(np.int16)
    array = alone(MicrophoneArray)
    array.component._microphones = Port(pack_sound(2.0, wave + np.int16(40)))
    array.component.read()
    (block,) = array.published["audio"]
    assert block.stamp == 2.0
    np.testing.assert_array_equal(block.samples, wave)


def test_the_detector_tells_where_and_when_it_saw_the_cup() -> None:
    middle = arm_model.TRAY_HEIGHT + arm_model.CUP_HEIGHT / 2
    jpeg = Camera().jpeg(np.array([0.09, 0.12, middle]), [])
    detector = alone(ObjectDetector)
    detector.component._cameras = Port(pack_picture(3.0, jpeg))
    detector.component.look()
    (cup,) = detector.published["cup"]
    assert (cup.stamp, cup.x, cup.y) == pytest.approx((3.0, 0.09, 0.12), abs=0.006)


def test_the_screen_names_who_was_seen_lately() -> None:
    clock = VirtualClock()
    display = alone(ScreenDisplay, clock=clock)
    display.component._screen = screen = Port()
    picture = Image(0.0, face(0.0, 0.0, closed=False))
    display.component.sentence(Sentence(4.0, "It is ten.", "what is the time"))
    display.component.seen(Seen(0.0, "Anna", 0.0, 2.0))
    display.component.face(picture)
    clock.time += FORGETS + 0.1
    display.component.face(picture)
    named, forgotten = screen.screens
    assert named[:4] == (4.0, "what is the time", "It is ten.", "Anna")
    assert named.picture[:2] == b"\xff\xd8"
    assert forgotten.seen == ""
