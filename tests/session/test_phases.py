"""Tasks with an order: placed by phases, and refused or said by what runs them."""

import re
from pathlib import Path

import pytest

import poise
from poise.errors import RobotError, UsageError
from poise.model import load
from poise.model.robot import Robot
from poise.session.placement import order_unused, place, runnable

DOCS = Path(__file__).parents[2] / "docs/tasks.md"


@pytest.fixture
def waiter(tmp_path: Path) -> Robot:
    """Return the robot of the documents: 30 % three times on two halves of a core."""
    (text,) = re.findall(r"```yaml\n(robot:.*?)```", DOCS.read_text(), re.DOTALL)
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    return load(path)


def test_three_actions_one_after_the_other_fit(waiter: Robot) -> None:
    placed = poise.place(waiter, "serve")
    assert placed.feasible
    assert list(placed.phases) == ["look", "go", "greet"]
    assert placed.moves == ()
    assert "proven to be the least" in str(placed)
    assert placed.explain("wheels").component == "wheels"  # type: ignore[union-attr]


def test_all_at_once_they_do_not(waiter: Robot) -> None:
    placed = place(waiter, "serve", at_once=True)
    assert not placed.feasible
    assert list(placed.phases) == ["serve"]
    assert "cpu" in placed.reason


def test_what_runs_all_at_once_refuses_them(waiter: Robot) -> None:
    with pytest.raises(RobotError, match="fits phase by phase, but not all at once"):
        runnable(waiter, "serve", None)
    by_phases = place(waiter, "serve")
    with pytest.raises(UsageError, match=r"3 phases \(look, go, greet\)"):
        runnable(waiter, "serve", by_phases)


def test_what_runs_all_at_once_says_so(waiter: Robot) -> None:
    assert "has 3 phases, which are not run in order" in order_unused(waiter, "serve")


def test_a_rule_places_each_phase_and_a_file_none(waiter: Robot) -> None:
    placed = place(waiter, "serve", method="round-robin")
    assert {name: dict(r.placement) for name, r in placed.phases.items()} == {
        "look": {"eyes": "left"},
        "go": {"wheels": "left"},
        "greet": {"mouth": "left"},
    }
    with pytest.raises(UsageError, match="a file places all at once"):
        place(waiter, "serve", method="placement.yaml")
