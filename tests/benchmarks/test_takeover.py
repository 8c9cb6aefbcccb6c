"""Managers that are killed at random steps are succeeded without a message lost."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from poise.emulate import probe_host
from tests.waiting import LONG

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow]

ROOT = Path(__file__).parents[2]


def test_ten_managers_in_turn_keep_a_robot_consistent() -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.takeover", "--moves", "10", "--json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=2 * LONG,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["half_done"] > 0
    wrong = ("active_twice", "missing", "restarted", "lost", "doubled", "reordered")
    assert not any(result[name] for name in wrong)
