"""Tasks with an order: placed by phases, and refused or said by what runs them."""

import re
from pathlib import Path

import pytest
from msgspec.structs import replace

import poise
from poise.errors import UsageError
from poise.model import load
from poise.model.robot import Action, Robot, Task
from poise.session.placing.first_phase import first_phase
from poise.session.placing.placement import place

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


def test_only_what_the_first_action_needs_runs_first(waiter: Robot) -> None:
    said: list[str] = []
    first = first_phase(waiter, ["serve"], None, said.append)
    assert dict(first.placed.where) == {"eyes": "left"}
    assert said == ["task 'serve' starts, with priority 0"]
    by_phases = place(waiter, "serve", method="round-robin")
    first = first_phase(waiter, ["serve"], by_phases, said.append)
    assert (first.placed.method, dict(first.placed.where)) == (
        "round-robin",
        {"eyes": "left"},
    )


def test_several_tasks_start_together(waiter: Robot) -> None:
    task = Task(name="talk", actions=(Action(name="say", functions=("talking",)),))
    both = replace(waiter, tasks=(*waiter.tasks, task))
    first = first_phase(both, ["serve", "talk"], None, lambda _: None)
    assert first.placed.where.keys() == {"eyes", "mouth"}
    third = Task(name="go", actions=(Action(name="go", functions=("driving",)),))
    all_ = replace(both, tasks=(*both.tasks, third))
    first = first_phase(all_, ["serve", "talk", "go"], None, lambda _: None)
    assert len(first.placed.result.suspended) == 1


def test_a_rule_places_each_phase_and_a_file_none(waiter: Robot) -> None:
    placed = place(waiter, "serve", method="round-robin")
    assert {name: dict(r.placement) for name, r in placed.phases.items()} == {
        "look": {"eyes": "left"},
        "go": {"wheels": "left"},
        "greet": {"mouth": "left"},
    }
    with pytest.raises(UsageError, match="a file places all at once"):
        place(waiter, "serve", method="placement.yaml")
