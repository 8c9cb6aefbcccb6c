"""The tutorial's seven steps do what they say."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command import Poise, called

ROOT = Path(__file__).parents[2]
PAGE = "docs/tutorial.md"
ROBOT = "tutorial-patrol"
"""Its name in the tests, beside which robots of other tests run."""
STEPS = re.split(r"^## \d\. ", (ROOT / PAGE).read_text(), flags=re.MULTILINE)[1:]

Write = Callable[[str, Path], list[str]]


def commands(step: int) -> list[list[str]]:
    """Return the command lines of a step, without `poise`."""
    blocks = re.findall(r"```sh\n(.*?)```", STEPS[step - 1], re.DOTALL)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines()]


def test_there_are_seven_steps_each_with_a_command_or_a_file() -> None:
    assert len(STEPS) == 7
    assert all(
        commands(step) or "`patrol.py`" in STEPS[step - 1] for step in range(1, 8)
    )


@pytest.mark.slow
def test_step_1_shows_that_the_static_placement_does_not_fit() -> None:
    ((*words,),) = commands(1)
    done = called(words, ROOT)
    assert done.returncode == 0
    assert re.search(r"feasible +NO +yes", done.stdout)


def test_it_has_the_files_of_a_robot(write_files: Write, tmp_path: Path) -> None:
    names = write_files(PAGE, tmp_path)
    assert names == ["computers.yaml", "patrol.py", "robot.yaml"]


@pytest.mark.exhaustive
@pytest.mark.slow
def test_steps_2_to_7_run(write_files: Write, poise: Poise, tmp_path: Path) -> None:
    write_files(PAGE, tmp_path)
    computers = tmp_path / "computers.yaml"
    computers.write_text(computers.read_text().replace("patrol", ROBOT))
    for words in [words for step in range(2, 8) for words in commands(step)]:
        by_name = words[0] in {"move", "status", "stop", "emulate"}
        done = poise(*words, *(["--robot", ROBOT] if by_name else []))
        code, output = done.returncode, done.stdout + done.stderr
        is_busy = "too busy to give" in output  # this machine; so it is no failure
        if code and is_busy and words[0] == "profile":
            pytest.skip(f"this machine is too busy to measure: {output}")
        assert code == 0 or is_busy, (words, output)
