from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from poise.errors import UsageError
from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    Distribution,
    Profile,
    TimerProfile,
)
from poise.view.profile_plot import plot_profile

pytest.importorskip("matplotlib")

TIMER = TimerProfile(period=0.1, median=0.01, p99=0.02, maximum=0.03)
PROFILE = Profile(
    robot="r",
    poise="0.1.0",
    computer="a",
    speed=0.5,
    at="today",
    seconds=30.0,
    components={
        "eye": ComponentProfile(
            version="1",
            cpu=Distribution(mean=0.1, sustained=0.12, peak=0.4, error=0.01),
            memory=8e6,
            timers={"look": TIMER},
        ),
        "mind": ComponentProfile(version="2", cpu=Distribution(mean=0.3), stable=False),
    },
    connectors={"eye.x-mind.x": ConnectorProfile(messages=10.0, size=1000.0)},
)
EMPTY = Profile(robot="r", poise="", computer="a", speed=1.0, at="", seconds=1.0)
BEGINNINGS = {".svg": b"<?xml", ".png": b"\x89PNG", ".pdf": b"%PDF"}


@pytest.mark.slow
@pytest.mark.parametrize("ending", BEGINNINGS)
def test_the_name_says_the_format(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"profile{ending}"
    plot_profile(PROFILE, {"eye.x-mind.x": 0.1}, path)
    assert path.read_bytes().startswith(BEGINNINGS[ending])


@pytest.mark.slow
def test_names_components_timers_and_connectors(tmp_path: Path) -> None:
    path = tmp_path / "profile.svg"
    plot_profile(PROFILE, {"eye.x-mind.x": 0.1}, path)
    texts = {(e.text or "").strip() for e in ET.parse(path).iter() if e.text}
    shown = {"eye", "mind", "eye.look", "eye.x-mind.x", "p99 of 100 ms", "demand"}
    assert shown <= texts
    assert "CPU; not stable: mind" in texts


@pytest.mark.slow
def test_the_same_profile_makes_the_same_picture(tmp_path: Path) -> None:
    paths = tmp_path / "one.svg", tmp_path / "other.svg"
    for path in paths:
        plot_profile(PROFILE, {}, path)
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.slow
def test_draws_a_profile_of_nothing(tmp_path: Path) -> None:
    plot_profile(EMPTY, {}, tmp_path / "profile.svg")
    assert (tmp_path / "profile.svg").stat().st_size > 0


def test_says_which_formats_there_are(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"ends in \.svg, \.png, \.pdf"):
        plot_profile(PROFILE, {}, tmp_path / "profile.jpeg")
