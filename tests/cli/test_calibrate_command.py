"""`poise calibrate` as users run it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from poise.cli.command_table import build
from poise.emulate import StarvationWatch
from poise.errors import RunError
from poise.estimate.profiles import Costs, KindCosts, Store
from poise.session.profiling import calibrate as calibration
from poise.session.profiling.calibrate import ComputerSpeed
from poise.session.profiling.stored_profiles import STORE
from tests.command import called

HELLO = Path(__file__).parents[2] / "examples" / "hello"


@pytest.fixture(autouse=True)
def _robot(tmp_path: Path) -> None:
    for name in ("hello.py", "robot.yaml"):
        shutil.copy(HELLO / name, tmp_path)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_measures_speeds_and_costs_says_a_busy_machine_and_keeps_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(StarvationWatch, "end", lambda _: {"left": 60.0})
    for seconds in (2, 8, 24):  # the busier the machine is, the longer it takes
        words = ["calibrate", "robot.yaml", "--for", f"{seconds}s", "--force"]
        done = called(words, tmp_path)
        if "a longer --for" not in done.stderr:
            break
    assert done.returncode == 0, done.stdout + done.stderr
    assert "loops per CPU second" in done.stdout
    assert "this machine was too busy to give the emulated computers" in done.stdout
    assert "(left for 60.0 s)" in done.stdout
    assert "written to the store" in done.stdout
    with Store(tmp_path / STORE) as store:
        costs = store.latest_costs("hello")
    assert list(costs) == ["direct", "local", "remote"]
    assert all(costs[kind].source.call > 0 for kind in ("local", "remote"))


@pytest.mark.slow
def test_knows_the_robots_computers(tmp_path: Path) -> None:
    done = called(["calibrate", "robot.yaml", "--reference", "middle"], tmp_path)
    assert done.returncode == 2
    assert "--reference middle: the computers are left, right" in done.stderr


@pytest.mark.slow
def test_a_measurement_takes_time(tmp_path: Path) -> None:
    done = called(["calibrate", "robot.yaml", "--for", "0 s"], tmp_path)
    assert done.returncode == 2
    assert "must last longer than 0 s" in done.stderr


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
    # the record is public: docs/output.schema.json
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
