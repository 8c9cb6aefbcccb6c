"""The whole demo, with drives that are too short to reach the goal."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from msgspec.structs import replace

from poise.cli import demo as demo_command
from poise.wire.records.deployment import Summary
from tests.waiting import LONG

SHORT = """
from poise.cli import demo, demo_scene
from poise.cli.main import main

demo_scene._DRIVE, demo_scene._MOVE_AT, demo._CALLS = 3.0, 1.0, 1.0
main()
"""


def demo() -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", SHORT, "demo", "--json"],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )


@pytest.mark.slow
def test_drives_moves_and_calls() -> None:
    done = demo()
    assert done.returncode == 1, done.stderr  # for the outcome is not the paper's
    assert done.stdout, done.stderr
    report = json.loads(done.stdout)
    assert [drive["method"] for drive in report["runs"]] == ["static", "auto"]
    static, auto = report["runs"]
    assert set(static["placement"].values()) < set(auto["placement"].values())
    for drive in report["runs"]:
        assert not drive["goal_reached"]
        assert drive["cpu_share"].keys() == {"main", "vision"}
        assert drive["pose_age"]["count"] > 0
    assert report["scene"]["move"]["component"] == "localiser"
    assert {"direct", "message"} == report["calls"].keys()
    assert all(call["count"] > 0 for call in report["calls"].values())


def test_a_drive_without_a_result_is_trouble() -> None:
    """The static drive should fail; one that says nothing has not."""
    good = demo_command.Drive(
        method="auto",
        deadline_miss_share=0.0,
        pose_age=Summary(),
        map_age=Summary(),
        goal_reached=True,
        decision_seconds=0.0,
        cpu_share={},
        seconds=1.0,
        placement={},
        invalid="",
    )
    missing = "the simulator ended without a result"
    static = replace(good, method="static", goal_reached=False, deadline_miss_share=1.0)
    silent = replace(static, invalid=missing)
    assert demo_command.find_trouble((static, good)) == ""
    assert missing in demo_command.find_trouble((silent, good))
