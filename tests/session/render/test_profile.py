from __future__ import annotations

import io
import re
from collections.abc import Mapping
from pathlib import Path

import pytest
from msgspec.structs import replace
from rich.console import Console
from typer.testing import CliRunner

from poise.cli.command_table import build
from poise.estimate import profiles as profile_file
from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    Distribution,
    HandlerProfile,
    Profile,
    Store,
    TimerProfile,
)
from poise.model import load
from poise.model.robot import Robot
from poise.session.render.profile_tables import history_table, profile_parts
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


def shown(
    folder: Path,
    memory: float = 1e6,
    handlers: Mapping[str, HandlerProfile] = {},
    **timers: TimerProfile,
) -> str:
    """Return what is printed of a profile of a robot without connectors."""
    file = folder / "robot.yaml"
    file.write_text(ROBOT.replace("profile: profile.yaml\n", ""))
    out = io.StringIO()
    measured = replace(
        eye(0.3), memory=memory, base=12e6, timers=timers, handlers=handlers
    )
    profile = replace(NOW, components={"eye": measured})
    console = Console(file=out, width=80, color_system=None)
    console.print(*profile_parts(load(file), profile))
    return out.getvalue()


def test_a_timer_that_never_ran_has_no_times(tmp_path: Path) -> None:
    ran = TimerProfile(period=0.1, median=0.01, p99=0.02, maximum=0.03, missed=0.0)
    never = TimerProfile(period=30.0, median=0.0, p99=0.0, maximum=0.0, missed=0.0)
    lines = shown(tmp_path, look=ran, rest=never).splitlines()
    rows = [re.split(r"\s{2,}", x.strip()) for x in lines if x.startswith("eye.")]
    assert rows == [
        ["eye.look", "100 ms", "10 ms", "20 ms", "30 ms", "0.0%"],
        ["eye.rest", "30 s"],
    ]
    (said,) = (x for x in lines if x.startswith("not known"))
    assert "eye.rest runs, as no run ended" in said


def test_a_timer_without_a_deadline_missed_none(tmp_path: Path) -> None:
    ran = TimerProfile(period=0.1, median=0.01, p99=0.02, maximum=0.03)
    (row,) = (x for x in shown(tmp_path, look=ran).splitlines() if "eye.look" in x)
    assert re.split(r"\s{2,}", row.strip())[-1] == "30 ms"


def test_a_handler_of_which_some_runs_wait_is_shown(tmp_path: Path) -> None:
    taken = HandlerProfile(
        mean=0.005, median=0.004, p99=0.006, waiting=0.33, wait=0.03, wait_p99=0.05
    )
    handlers = {"see": taken, "look": replace(taken, waiting=0.001)}
    lines = shown(tmp_path, handlers=handlers).splitlines()
    (row,) = (line for line in lines if line.startswith("eye."))
    assert row.split() == ["eye.see", "4", "ms", "33%", "30", "ms", "50", "ms"]
    assert "handler" not in shown(tmp_path, handlers={"look": handlers["look"]})


def test_calls_that_wait_are_shown_with_their_connector() -> None:
    taken = HandlerProfile(
        mean=0.005, median=0.004, p99=0.006, waiting=0.33, wait=0.03, wait_p99=0.05
    )
    calls = ConnectorProfile(calls=1.0, answering=taken)
    robot, out = Robot(name="r", computers=()), io.StringIO()
    console = Console(file=out, width=200, color_system=None)
    now = replace(NOW, connectors={"eye.x-mind.y": calls})
    console.print(*profile_parts(robot, now))
    (row,) = (line for line in out.getvalue().splitlines() if "30 ms" in line)
    assert row.split() == ["eye.x-mind.y", "4", "ms", "33%", "30", "ms", "50", "ms"]


def test_a_table_without_rows_is_left_out(tmp_path: Path) -> None:
    said = shown(tmp_path)
    assert "timer" not in said
    assert "connector" not in said
    assert "overhead" not in said


def test_memory_below_what_can_be_measured_is_no_figure(tmp_path: Path) -> None:
    said = shown(tmp_path, memory=0.0)
    assert "0 B" not in said
    assert "too little memory to tell from an empty container: eye" in said
    assert "too little" not in shown(tmp_path)


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
def test_a_profile_is_shown_from_a_folder_that_cannot_be_written(
    tmp_path: Path,
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / ".poise").symlink_to("/proc")  # where nobody makes a file
    words = ["profile", "show", str(tmp_path / "robot.yaml"), "--history"]
    missing = CliRunner().invoke(build(words), words)
    assert "has no profile: `poise profile " in str(missing.exception)
    (tmp_path / "profile.yaml").write_text(profile_file.to_text(NOW))
    assert CliRunner().invoke(build(words), words).exit_code == 0


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
