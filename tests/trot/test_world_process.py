from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from trot.device import Device
from trot.laser_model import BEAMS
from trot.packets import (
    MICROPHONES,
    SOUND_SAMPLES,
    pack_command,
    unpack_odometry,
    unpack_ranges,
    unpack_sound,
)

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parents[2] / "examples" / "trot"
LIMIT = 60.0

Process = subprocess.Popen[bytes]


@pytest.fixture
def world(tmp_path: Path) -> Iterator[Process]:
    process = subprocess.Popen(
        [sys.executable, "-m", "trot.world"],
        cwd=EXAMPLE,
        env={**os.environ, "POISE_RUN": str(tmp_path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    with process:
        assert process.stdout.readline() == b"ready\n"
        yield process
        process.kill()


def result(world: Process) -> dict[str, Any]:
    out, _ = world.communicate(timeout=LIMIT)
    assert world.returncode == 0
    answer: dict[str, Any] = json.loads(out)
    return answer


def first(device: Device) -> bytes:
    packets = device.receive(timeout=LIMIT)
    assert packets
    return packets[0]


def test_serves_scans_odometry_and_sound(world: Process, tmp_path: Path) -> None:
    laser = Device(str(tmp_path / "laser.sock"))
    wheels = Device(str(tmp_path / "wheels.sock"))
    microphones = Device(str(tmp_path / "microphones.sock"))
    stamp, ranges = unpack_ranges(first(laser))
    assert ranges.shape == (BEAMS,)
    assert abs(unpack_odometry(first(wheels))[0] - stamp) < LIMIT
    assert unpack_sound(first(microphones))[1].shape == (MICROPHONES, SOUND_SAMPLES)
    world.send_signal(signal.SIGTERM)
    assert not result(world)["goal_reached"]
    for device in (laser, wheels, microphones):
        device.close()


def test_obeys_commands_and_survives_nonsense(world: Process, tmp_path: Path) -> None:
    wheels = Device(str(tmp_path / "wheels.sock"))
    _, x, _, _ = unpack_odometry(first(wheels))
    assert wheels.send(b"nonsense")
    moved = x
    while moved < x + 0.02:
        assert wheels.send(pack_command(0.5, 0.0))
        moved = unpack_odometry(first(wheels))[1]
    wheels.close()
    world.send_signal(signal.SIGTERM)
    assert result(world)["path_length"] > 0


def test_a_component_may_come_back(world: Process, tmp_path: Path) -> None:
    laser = Device(str(tmp_path / "laser.sock"))
    first(laser)
    laser.close()
    first(laser)
    laser.close()
    assert world.poll() is None


def test_ends_with_its_standard_input(world: Process, tmp_path: Path) -> None:
    assert result(world).keys() >= {
        *("goal_reached", "seconds", "path", "path_error", "collisions"),
        *("cups_placed", "cups_dropped", "word_error_rate", "answer_seconds"),
        *("head_error_degrees", "good_recommendations", "recommendation_seconds"),
    }
    assert list(tmp_path.iterdir()) == []


def test_its_result_survives_signals_while_it_ends(world: Process) -> None:
    assert world.stdout is not None
    for _ in range(1000):
        world.send_signal(signal.SIGTERM)
    answer = json.loads(world.stdout.read())
    assert answer.keys() >= {"goal_reached", "seconds"}


def test_says_what_it_needs() -> None:
    environment = {k: v for k, v in os.environ.items() if k != "POISE_RUN"}
    ended = subprocess.run(
        [sys.executable, "-m", "trot.world"],
        cwd=EXAMPLE,
        env=environment,
        capture_output=True,
        timeout=LIMIT,
        check=False,
    )
    assert ended.returncode == 2
    assert b"POISE_RUN" in ended.stderr


def test_a_device_that_is_away_is_no_error(tmp_path: Path) -> None:
    device = Device(str(tmp_path / "laser.sock"))
    assert device.receive(timeout=0.01) == []
    assert not device.send(b"hello")
