"""Any executable is measured like a component: CPU and memory of its processes."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from poise.cli.command_table import build
from poise.errors import RobotError, UsageError
from poise.estimate import profiles as profile_file
from poise.model import load
from tests.command import Poise

ROBOT = """\
robot: r
computers: {main: {cpu: 1, memory: 1 GiB}}
architectures:
  burning:
    function: burning
    components:
      burner: {command: "python burn.py 20 64"}
      idler: {command: "sleep 1000"}
profile: profile.yaml
"""
BURN = """
import sys, time

share, mebibytes = int(sys.argv[1]) / 100, int(sys.argv[2])
held = b"x" * (mebibytes << 20)
release = time.monotonic()
while True:
    began = time.process_time()
    while time.process_time() - began < 0.05 * share:
        pass
    release = max(release + 0.05, time.monotonic())
    time.sleep(max(0.0, release - time.monotonic()))
"""


@pytest.mark.exhaustive
@pytest.mark.slow
def test_measures_command_line_components(tmp_path: Path, poise: Poise) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "burn.py").write_text(BURN)
    times = ("--for", "2s", "--warm-up", "2s", "--repeat", "1")
    done = poise("profile", "robot.yaml", *times, "--on", "main", "--write")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "demands written to " in done.stdout
    written = {c.name: c.demand for c in load(tmp_path / "robot.yaml").components()}
    assert written["burner"]["cpu"] > written["idler"]["cpu"]
    profile = profile_file.read(tmp_path / "profile.yaml")
    burner, idler = profile.components["burner"], profile.components["idler"]
    # a machine that is busy may give it less, never more, once it has started
    assert 0.05 < burner.cpu.mean < 0.23
    # one window that stands out raises the mean, and not the 95th percentile
    assert burner.cpu.p95 <= burner.cpu.p99 <= burner.cpu.peak >= burner.cpu.mean
    assert idler.cpu.mean < 0.02
    # 64 MiB are its own, and Python's own few, less what it shares with the container
    assert 60 * 2**20 < burner.memory < 100 * 2**20
    assert 0 <= idler.memory < 10 * 2**20
    assert burner.start > 0
    changed = BURN.replace("0.05", "0.06")
    (tmp_path / "burn.py").write_text(changed)
    shown = poise("profile", "show", "robot.yaml")
    assert "changed since it was measured: burner" in shown.stdout


@pytest.mark.slow
def test_a_profile_that_has_no_file_is_used_as_it_is_said(
    tmp_path: Path, poise: Poise
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT.replace("profile: profile.yaml\n", ""))
    (tmp_path / "burn.py").write_text(BURN)
    times = ("--for", "1s", "--warm-up", "0.5s", "--repeat", "1")
    done = poise("profile", "robot.yaml", *times)
    assert "`poise profile show robot.yaml --write`" in done.stdout
    assert poise("profile", "show", "robot.yaml", "--write").returncode == 0
    assert all("cpu" in c.demand for c in load(tmp_path / "robot.yaml").components())


@pytest.mark.slow
def test_a_computer_that_a_real_robot_has_not_is_named(tmp_path: Path) -> None:
    hello = Path(__file__).parents[2] / "examples" / "hello"
    text = (hello / "robot.yaml").read_text()
    for name, address in (("left", "127.0.0.2"), ("right", "127.0.0.3")):
        text = text.replace(f"{name}: {{", f"{name}: {{address: {address}, ")
    (tmp_path / "robot.yaml").write_text(text)
    (tmp_path / "hello.py").write_bytes((hello / "hello.py").read_bytes())
    words = ["profile", str(tmp_path / "robot.yaml"), "--on", "middle"]
    result = CliRunner().invoke(build(words), words)
    assert isinstance(result.exception, UsageError)
    assert "--on middle: the robot's computers are left, right" in str(result.exception)


@pytest.mark.slow
@pytest.mark.parametrize("words", [["profile", "show"], ["calibrate"]])
def test_the_profile_of_another_robot_is_refused(
    words: list[str], tmp_path: Path
) -> None:
    sorter = Path(__file__).parents[2] / "examples" / "sorter"
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "burn.py").write_text(BURN)
    (tmp_path / "profile.yaml").write_bytes((sorter / "profile.yaml").read_bytes())
    words = [*words, str(tmp_path / "robot.yaml")]
    result = CliRunner().invoke(build(words), words)
    assert isinstance(result.exception, RobotError)
    said = str(result.exception)
    assert (
        "is the profile of robot 'sorter', not of 'r': name a file of its own" in said
    )
