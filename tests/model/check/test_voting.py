"""Managers follow each other by a majority, which has to be possible."""

from collections.abc import Callable
from pathlib import Path

import pytest

from poise.errors import FileProblem
from poise.model.check.allowed_computers import allowed_computers, notes_of
from poise.model.loading import load
from poise.plan import problem_of

Find = Callable[[str], tuple[FileProblem, ...]]

WITNESSED = """
robot: r
computers:
  left: {cpu: 2, memory: 1 GiB}
  right: {cpu: 2, memory: 1 GiB}
  router: {cpu: 1, memory: 64 MiB, witness: true}
links:
  - {between: [left, router], bandwidth: 100 Mbit/s}
manager: [left, right]
devices:
  motor: {computer: left}
  lamp: {computer: right}
architectures:
  nav:
    function: navigation
    components:
      scanner: {cpu: 10%, memory: 1 MiB}
"""
KEPT = "\n".join(
    line
    for line in WITNESSED.splitlines()
    if "router" not in line and "links" not in line
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (KEPT, "no majority is left when one dies"),
        (KEPT + "\nkeeps: [arm]", "there is no device 'arm'"),
        (KEPT + "\nkeeps: [motor, lamp]", "on left and right, and only one"),
        (WITNESSED + "\nkeeps: [motor]", "of 3 computers a majority goes on"),
        (
            WITNESSED.replace("[left, right]", "[left, router]"),
            "'router' is a witness",
        ),
        (WITNESSED.replace("computer: right", "computer: router"), "a witness"),
        (WITNESSED.replace("cpu: 10%", "only: [router, left], cpu: 10%"), "a witness"),
        (
            WITNESSED + "policies: {p: {for each: component, when: cpu > 1, "
            "do: move, to: router}}",
            "'router' is a witness",
        ),
        (WITNESSED.replace("manager: [left, right]", ""), "no computer may lead"),
        (
            KEPT.replace("manager: [left, right]", "keeps: [lamp]"),
            "no computer may have the manager",
        ),
    ],
)
def test_says_why_no_manager_could_follow(find: Find, text: str, words: str) -> None:
    assert any(words in str(problem) for problem in find(text)), find(text)


def test_nothing_is_placed_on_a_witness(tmp_path: Path, find: Find) -> None:
    assert find(WITNESSED) == ()
    file = tmp_path / "robot.yaml"
    file.write_text(WITNESSED)
    robot = load(file)
    assert allowed_computers(robot)["scanner"] == {"left", "right"}
    assert [c.name for c in problem_of(robot).computers] == ["left", "right"]
    assert robot.votes == {"left": 1, "right": 1, "router": 1}
    assert notes_of(robot) == ()


def test_the_side_with_the_devices_that_are_kept_goes_on(
    tmp_path: Path, find: Find
) -> None:
    text = KEPT + "\nkeeps: [motor]\n"
    assert find(text) == ()
    file = tmp_path / "robot.yaml"
    file.write_text(text)
    robot = load(file)
    assert robot.votes == {"left": 2, "right": 1}
    (note,) = notes_of(robot)
    assert note.startswith("when right cannot be reached, left goes on")
