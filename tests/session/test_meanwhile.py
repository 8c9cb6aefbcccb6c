"""What a script does while it runs a robot."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path
from typing import Any, cast

import pytest

import poise
from tests.waiting import LONG

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

_HELLO = Path("examples/hello").resolve()


@pytest.fixture
def robot(tmp_path: Path) -> poise.Robot:
    """Return a robot of this test alone: a counter and a printer."""
    text = (_HELLO / "robot.yaml").read_text()
    file = tmp_path / "robot.yaml"
    file.write_text(text.replace("robot: hello", f"robot: meanwhile-{os.getpid()}"))
    shutil.copy(_HELLO / "hello.py", tmp_path)
    return poise.load(file)


def test_a_component_moves_and_the_report_says_where_it_ran_last(
    robot: poise.Robot,
) -> None:
    moved: list[str] = []

    def move_once(running: poise.Running, _: float) -> None:
        if not moved:
            here = running.status().placement["printer"]
            there = "left" if here == "right" else "right"
            assert running.move("printer", there).after == {"printer": there}
            moved.append(there)

    report = poise.run(robot, seconds=2.0, meanwhile=move_once)
    assert report.component("printer").computer == moved[0]


def test_what_it_raises_as_the_run_ends_is_raised(robot: poise.Robot) -> None:
    """It waits for longer than the run lasts."""

    def fail(_: poise.Running, __: float) -> None:
        time.sleep(3.0)
        raise LookupError("no cup is there")

    with pytest.raises(LookupError, match="no cup is there"):
        poise.run(robot, seconds=1.0, meanwhile=fail)


def test_what_it_raises_ends_the_run(robot: poise.Robot) -> None:
    def fail(_: poise.Running, __: float) -> None:
        raise LookupError("no cup is there")

    with pytest.raises(LookupError, match="no cup is there"):
        poise.run(robot, seconds=LONG, meanwhile=fail)


def test_what_is_no_function_is_refused_before_anything_starts(
    robot: poise.Robot,
) -> None:
    with pytest.raises(poise.UsageError, match="meanwhile: 3 is no function"):
        poise.run(robot, seconds=1.0, meanwhile=cast("Any", 3))
