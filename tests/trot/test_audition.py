from __future__ import annotations

import math

import numpy as np
import pytest

from poise.clock import Stamp
from tests.trot.alone import alone
from trot.audition.head_turner import HeadTurner
from trot.audition.sound_localiser import BLOCKS, SoundLocaliser
from trot.audition.source_tracker import SourceTracker
from trot.messages import AudioBlock, Bearing, Pose, Source
from trot.packets import unpack_angle
from trot.world import sound
from trot.world.head import Head
from trot.world.record import recorded
from trot.world.sound import PERSON, Sound

Spot = tuple[float, float, float]


class Poses:
    """Knows where the robot is."""

    def __init__(self, *pose: float) -> None:
        self.pose = pose

    def latest_pose(self) -> Pose:
        return Pose(Stamp(0.0), *self.pose)


def test_the_person_is_where_the_bearing_says() -> None:
    """From (1.7, 2.1) the person at (4.7, 2.1) is straight along x."""
    assert sound.bearing((1.7, 2.1, 0.0)) == pytest.approx(0.0)
    assert sound.bearing((1.7, 2.1, 1.0)) == pytest.approx(-1.0)
    assert sound.bearing((4.7, 0.1, 0.0)) == pytest.approx(math.pi / 2)


def test_the_voice_arrives_as_late_as_it_is_far() -> None:
    """From 3 m away, 60 cm higher, it takes 143 samples; echoes are weaker."""
    clap = sound.responses((1.7, 2.1, 0.0))
    first = [int(np.nonzero(each)[0][0]) for each in clap]
    assert np.mean(first) == pytest.approx(math.hypot(3, 0.6) / 343 * 16_000, abs=2)
    assert all(
        each.argmax() <= start + 1 for each, start in zip(clap, first, strict=True)
    )


@pytest.mark.slow
@pytest.mark.parametrize("robot", [(1.6, 2.8, 0.6), (4.0, 4.4, -1.0), (6.5, 1.5, 2.5)])
def test_hears_where_somebody_speaks(robot: Spot) -> None:
    """In a room with echoes the median is within 4 degrees."""
    _, samples = recorded()[0]
    source, localiser = Sound(), alone(SoundLocaliser)
    source.say(samples)
    while source.is_speaking:
        localiser.component.audio(AudioBlock(0.0, source.block(robot)))
    off = [
        math.remainder(heard.angle - sound.bearing(robot), 2 * math.pi)
        for heard in localiser.published["bearing"]
    ]
    assert len(off) > 10
    assert np.median(np.abs(off)) < math.radians(4)


def test_hears_nothing_where_nobody_speaks() -> None:
    source, localiser = Sound(), alone(SoundLocaliser)
    for _ in range(2 * BLOCKS):
        localiser.component.audio(AudioBlock(0.0, source.block((2.0, 2.0, 0.0))))
    assert localiser.published["bearing"] == []


def test_finds_the_person_from_three_places() -> None:
    """Exact bearings, some from a wall's echo: the person is where lines cross."""
    poses = Poses(0.0, 0.0, 0.0)
    tracker = alone(SourceTracker, providers={"poses": poses})
    for spot in [(1.5, 3.0, 0.5), (3.0, 4.4, -0.3), (5.5, 3.5, 2.0)]:
        poses.pose = spot
        for turn in range(15):
            angle = 2.5 if turn % 7 == 3 else sound.bearing(spot)
            tracker.component.bearing(Bearing(0.0, angle))
    found = tracker.published["source"][-1]
    assert (found.x, found.y) == pytest.approx(PERSON, abs=0.3)
    assert found.spread < 0.5


class Neck:
    def __init__(self) -> None:
        self.angles: list[float] = []

    def send(self, packet: bytes) -> bool:
        self.angles.append(unpack_angle(packet))
        return True


def test_turns_the_head_to_the_person() -> None:
    """Robot at (1, 1) looking along y; the person at (3, 1) is to its right."""
    turner = alone(HeadTurner, providers={"poses": Poses(1.0, 1.0, math.pi / 2)})
    turner.component._neck = neck = Neck()
    turner.component.turn()
    turner.component.source(Source(0.0, 3.0, 1.0, 0.1))
    turner.component.turn()
    assert neck.angles == pytest.approx([-math.pi / 2])
    assert turner.published["attention"][0].bearing == neck.angles[0]


def test_the_head_needs_time_to_turn() -> None:
    """At 3 rad/s, 1.5 rad take half a second; it takes the shorter way round."""
    head = Head()
    head.wanted = 1.5
    for _ in range(4):
        head.step(0.1)
    assert head.angle == pytest.approx(1.2)
    head.angle, head.wanted = 3.0, -3.0
    head.step(0.02)
    assert head.angle > 3.0
    head.angle = 0.5
    head.judge(0.4)
    assert head.result() == {"head_error_degrees": pytest.approx(5.7)}
