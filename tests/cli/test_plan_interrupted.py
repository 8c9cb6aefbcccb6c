"""Ctrl-C ends a search, and what was found until then is printed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest

from benchmarks.random_robots import random_robot
from poise.plan import Problem

pytestmark = pytest.mark.slow


def interrupted(problem: Problem, folder: Path, *arguments: str) -> dict[str, Any]:
    """Return what `poise plan` prints when Ctrl-C is pressed while it decides.

    How long it takes to begin is not known: pressed before, it ends without a word.
    """
    path = folder / "problem.json"
    path.write_bytes(msgspec.json.encode(problem))
    command = [sys.executable, "-m", "poise", "plan", str(path), "--json", *arguments]
    for delay in (1, 2, 4, 8, 16, 32, 64):
        process = subprocess.Popen(command, stdout=subprocess.PIPE)
        time.sleep(delay)
        os.kill(process.pid, signal.SIGINT)
        printed, _ = process.communicate(timeout=60)
        if printed:
            assert process.returncode == 130
            answer: dict[str, Any] = json.loads(printed)
            return answer
    pytest.fail("it printed nothing")


def test_a_fleet_gets_the_best_placement_so_far(tmp_path: Path) -> None:
    answer = interrupted(random_robot(1, 10_000, 100), tmp_path, "--budget", "600")
    assert answer["stopped_by"] == "interrupted"
    assert answer["feasible"]
    assert len(answer["placement"]) == 10_000


def test_a_comparison_is_of_what_each_method_found(tmp_path: Path) -> None:
    methods = "greedy,search,exact,auto"
    robot = random_robot(1, 60, 6)
    answer = interrupted(robot, tmp_path, "--budget", "600", "--compare", methods)
    assert list(answer["results"]) == methods.split(",")
    for result in answer["results"].values():
        assert result["feasible"]
        assert result["stopped_by"] in {"done", "interrupted"}


def test_the_smallest_so_far_is_printed(tmp_path: Path) -> None:
    robot = random_robot(1, 60, 6, load=0.5)
    answer = interrupted(robot, tmp_path, "--budget", "600", "--smallest")
    (phase,) = answer["tasks"]["all"]["phases"]
    assert phase["stopped_by"] == "interrupted"
    assert set(phase["placement"].values()) <= set(answer["computers"])
