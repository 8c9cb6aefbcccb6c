"""`poise calibrate` as users run it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from poise.cli.command_table import build
from poise.errors import RunError
from poise.estimate.profile import Costs, KindCosts
from poise.estimate.profile.store import Store
from poise.session.calibration import calibrate as calibration
from poise.session.calibration.calibrate import ComputerSpeed
from poise.session.profiles import STORE
from tests.command import POISE, Poise
from tests.waiting import LONG

HELLO = Path(__file__).parents[2] / "examples" / "hello"


@pytest.fixture(autouse=True)
def _robot(tmp_path: Path) -> None:
    for name in ("hello.py", "robot.yaml"):
        shutil.copy(HELLO / name, tmp_path)


@pytest.mark.slow
def test_measures_speeds_and_costs_and_keeps_them(poise: Poise, tmp_path: Path) -> None:
    for seconds in (2, 8, 24):  # the busier the machine is, the longer it takes
        done = poise("calibrate", "robot.yaml", "--for", f"{seconds}s", "--force")
        if "a longer --for" not in done.stderr:
            break
    assert done.returncode == 0, done.stdout + done.stderr
    assert "loops per CPU second" in done.stdout
    assert "written to the store" in done.stdout
    with Store(tmp_path / STORE) as store:
        costs = store.latest_costs("hello")
    assert list(costs) == ["direct", "local", "remote"]
    assert all(costs[kind].source.call > 0 for kind in ("local", "remote"))


@pytest.mark.slow
def test_knows_the_robots_computers(poise: Poise) -> None:
    done = poise("calibrate", "robot.yaml", "--reference", "middle")
    assert done.returncode == 2
    assert "--reference middle: the computers are left, right" in done.stderr


def costs(folder: Path) -> dict[str, KindCosts]:
    with Store(folder / STORE) as store:
        return store.latest_costs("hello")


@pytest.mark.slow
def test_what_a_busy_machine_measured_is_kept_by_force_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    speeds = {name: ComputerSpeed(1e4, None) for name in ("left", "right")}
    found = {"direct": KindCosts(source=Costs(call=1e-5))}
    monkeypatch.setattr(calibration, "_speeds", lambda *_: (speeds, ["too busy"]))
    monkeypatch.setattr(calibration, "_costs", lambda *_: (found, "too busy"))
    words = ["calibrate", str(tmp_path / "robot.yaml"), "--json"]
    told = CliRunner().invoke(build(words), words)
    assert isinstance(told.exception, RunError)
    assert str(told.exception).startswith("not written: too busy. `--force`")
    assert costs(tmp_path) == {}
    # the record is public: docs/estimation.md
    assert json.loads(told.stdout) == {
        "reference": "left",
        "computers": {
            "left": {"loops": 1e4, "speed": None},
            "right": {"loops": 1e4, "speed": None},
        },
        "costs": {
            "direct": {
                "source": {"call": 1e-5, "message": 0.0, "byte": 0.0},
                "target": {"call": 0.0, "message": 0.0, "byte": 0.0},
            }
        },
        "busy": ["too busy"],
        "kept": False,
    }
    forced = CliRunner().invoke(build(words), [*words, "--force"])
    assert forced.exit_code == 0
    assert costs(tmp_path) == found


BURN = """
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
print("burning", flush=True)
while True:
    end = time.thread_time() + 0.04
    while time.thread_time() < end:
        pass
    time.sleep(0.06)
"""


@pytest.fixture
def _busy_machine() -> Iterator[None]:
    """Take two fifths of every CPU in real time, which no other process can."""
    if not Path("/proc/pressure/cpu").exists():
        pytest.skip("this kernel does not count how long processes wait for a CPU")
    burners = [
        subprocess.Popen([sys.executable, "-c", BURN, str(cpu)], stdout=subprocess.PIPE)
        for cpu in os.sched_getaffinity(0)
    ]
    try:
        if not all(each.stdout and each.stdout.readline() for each in burners):
            pytest.skip("this user may run no process in real time")
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.communicate()


@pytest.mark.slow
@pytest.mark.usefixtures("_busy_machine")
def test_a_busy_machine_is_said(tmp_path: Path) -> None:
    done = subprocess.run(
        [*POISE, "calibrate", "robot.yaml", "--for", "2s"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 1
    # what it saw, or that it saw nothing beside the load
    assert re.match("not written: |the cost of .* cannot be separated", done.stderr)
    assert "this machine was too busy" in done.stderr
    assert costs(tmp_path) == {}
