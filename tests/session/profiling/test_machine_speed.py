"""Emulated computers are as quick as those of the profile, on any machine."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.estimate import profiles as profile_file
from poise.estimate.profiles import Profile
from poise.model.robot import Computer, Robot
from poise.session.profiling import stored_profiles
from poise.session.profiling.stored_profiles import as_when_profiled

PROFILE = Profile(
    robot="r", poise="1", computer="left", speed=0.5, at="", seconds=1.0, loops=8000.0
)


def robot(folder: Path, profile: Profile | None, address: str | None = None) -> Robot:
    if profile is not None:
        (folder / "profile.yaml").write_text(profile_file.to_text(profile))
    computer = Computer(name="left", capacity={"cpu": 1.0}, speed=0.5, address=address)
    return Robot(
        name="r", folder=str(folder), computers=(computer,), profile="profile.yaml"
    )


@pytest.mark.parametrize(("loops", "speed"), [(16000.0, 0.25), (4000.0, 1.0)])
def test_a_quicker_machine_gives_less_of_its_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loops: float, speed: float
) -> None:
    monkeypatch.setattr(stored_profiles, "loops", lambda: loops)
    (left,) = as_when_profiled(robot(tmp_path, PROFILE)).computers
    assert left.speed == pytest.approx(speed)


@pytest.mark.parametrize(
    ("profile", "address"),
    [(None, None), (replace(PROFILE, loops=0.0), None), (PROFILE, "10.0.0.1")],
)
def test_otherwise_the_robot_stays_as_it_is(
    tmp_path: Path, profile: Profile | None, address: str | None
) -> None:
    known = robot(tmp_path, profile, address)
    assert as_when_profiled(known) == known
