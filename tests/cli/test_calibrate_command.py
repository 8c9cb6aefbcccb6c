"""`poise calibrate` as users run it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from poise.estimate.profile.store import Store
from poise.session.profiles import STORE
from tests.command import Poise

HELLO = Path(__file__).parents[2] / "examples" / "hello"


@pytest.fixture(autouse=True)
def _robot(tmp_path: Path) -> None:
    for name in ("hello.py", "robot.yaml"):
        shutil.copy(HELLO / name, tmp_path)


@pytest.mark.slow
def test_measures_speeds_and_costs_and_keeps_them(poise: Poise, tmp_path: Path) -> None:
    for seconds in (2, 8, 24):  # the busier the machine is, the longer it takes
        done = poise("calibrate", "robot.yaml", "--for", f"{seconds}s")
        if "a longer --for" not in done.stderr:
            break
    assert done.returncode == 0, done.stdout + done.stderr
    assert "loops per CPU second" in done.stdout
    assert "kept in the store" in done.stdout
    with Store(tmp_path / STORE) as store:
        costs = store.latest_costs("hello")
    assert list(costs) == ["direct", "local", "remote"]
    assert all(costs[kind].source.call > 0 for kind in ("local", "remote"))


@pytest.mark.slow
def test_knows_the_robots_computers(poise: Poise) -> None:
    done = poise("calibrate", "robot.yaml", "--reference", "middle")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--reference middle: the computers are left, right" in done.stderr
