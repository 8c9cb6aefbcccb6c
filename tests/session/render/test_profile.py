from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from msgspec.structs import replace
from rich.console import Console

from poise.estimate import profiles as profile_file
from poise.estimate.profiles import ComponentProfile, Distribution, Profile, Store
from poise.model import load
from poise.session.render.profile_tables import history_table
from tests.command import Poise

ROBOT = """\
robot: r
computers: {a: {cpu: 1, memory: 1 GiB}}
architectures:
  see: {function: seeing, components: {eye: {cpu: 10%}}}
profile: profile.yaml
"""


def eye(mean: float, version: str = "1") -> ComponentProfile:
    return ComponentProfile(
        version=version, cpu=Distribution(mean=mean), memory=2 * 2**20
    )


NOW = Profile(
    robot="r",
    poise="0.2.0",
    computer="a",
    speed=1.0,
    at="2026-03-01T00:00:00+00:00",
    seconds=30.0,
    components={"eye": eye(0.3, "2")},
)
BEFORE = replace(
    NOW, at="2026-02-01T00:00:00+00:00", poise="0.1.0", components={"eye": eye(0.1)}
)
FIRST = replace(BEFORE, at="2026-01-01T00:00:00+00:00")
ELSEWHERE = replace(BEFORE, computer="b")


def text(profiles: list[Profile]) -> str:
    out = io.StringIO()
    console = Console(file=out, width=200, color_system=None)
    console.print(history_table(NOW, profiles))
    return out.getvalue()


def test_compares_with_earlier_profiles_newest_first() -> None:
    (row,) = (x for x in text([NOW, BEFORE, FIRST]).splitlines() if "eye" in x)
    cells = re.split(r"\s{2,}", row.strip())
    assert cells == [
        "eye",
        "30.00%, 2 MiB",
        "10.00%, 2 MiB other code",
        "10.00%, 2 MiB",
    ]


def test_leaves_out_other_computers() -> None:
    shown = text([ELSEWHERE, BEFORE])
    assert shown.count("Poise 0.1.0") == 1


def test_what_was_not_there_is_empty() -> None:
    (row,) = (
        x for x in text([replace(BEFORE, components={})]).splitlines() if "eye" in x
    )
    assert re.split(r"\s{2,}", row.strip()) == ["eye", "30.00%, 2 MiB"]


@pytest.mark.slow
def test_shows_draws_and_compares(tmp_path: Path, poise: Poise) -> None:
    pytest.importorskip("matplotlib")
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "profile.yaml").write_text(profile_file.to_text(NOW))
    with Store(tmp_path / ".poise" / "profiles.sqlite") as store:
        store.add(BEFORE)
    plot = "profile[b].svg"  # no markup
    done = poise("profile", "show", "robot.yaml", "--history", "--plot", plot)
    assert done.returncode == 0, done.stderr
    assert "Poise 0.1.0" in done.stdout
    assert "changed since it was measured: eye" in done.stdout
    assert f"drawn to {plot}" in done.stdout
    assert (tmp_path / plot).read_text().startswith("<?xml")


@pytest.mark.slow
def test_a_path_is_no_markup(tmp_path: Path, poise: Poise) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "eye[").mkdir()
    done = poise("draw", "robot.yaml", "-o", "eye[/b].svg")
    assert done.returncode == 0, done.stderr
    assert "wrote eye[/b].svg" in done.stderr


@pytest.mark.slow
def test_show_writes_the_demands_of_the_last_profile(
    tmp_path: Path, poise: Poise
) -> None:
    robot = tmp_path / "robot.yaml"
    robot.write_text(ROBOT)
    (tmp_path / "profile.yaml").write_text(profile_file.to_text(NOW))
    done = poise("profile", "show", "robot.yaml", "--write")
    assert done.returncode == 0, done.stderr
    assert f"demands written to {robot.name}" in done.stdout
    (eye_,) = load(robot).components()
    # 2 MiB and a tenth; CPU was sustained at 0
    assert eye_.demand == {"cpu": 0.0, "memory": pytest.approx(2.2 * 2**20)}
