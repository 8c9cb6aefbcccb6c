"""Whether another placement is worth its moves."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.adaptation.decision import decide, shortage
from poise.model.robot import Robot
from tests.manage.adaptation.conftest import Make


def test_what_a_background_load_takes_away_makes_a_component_move(
    facts: Make,
) -> None:
    """Other programs get 0.2 of 0.5 cores, and want half as much again."""
    found = decide(facts(background={"left": 0.2}), {}, {})
    assert found.acts
    assert found.proposal is not None
    assert len(found.proposal.steps) == 1
    assert found.gain == pytest.approx(0.2 * 30)
    assert found.cost == pytest.approx(0.3 + 0.2 * 0.05)
    assert found.why == ("1 step: cost 0.31 core-seconds, gain 6.00 within 30 s")


def test_a_move_that_paused_its_component_for_long_is_not_worth_it(
    facts: Make,
) -> None:
    seen = facts(background={"left": 0.2})
    found = decide(seen, {}, {"a": 60.0, "b": 60.0})
    assert not found.acts
    assert found.cost > found.gain
    assert found.why.startswith("it stays as it is: ")


def test_when_all_fits_another_placement_does_not_help(facts: Make) -> None:
    found = decide(facts(missed=("a",)), {}, {})
    assert not found.acts
    assert "all components fit where they are" in found.why


def test_when_nothing_fits_it_says_what_is_missing(facts: Make) -> None:
    full = facts(background={"left": 0.45, "right": 0.45}, missed=("a",))
    found = decide(full, {}, {})
    assert not found.acts
    assert found.why.startswith("no placement can help: task 'work' has no placement")


def test_a_component_does_not_go_where_it_is_barred(facts: Make) -> None:
    found = decide(facts(background={"left": 0.2}), {"a": {"right"}}, {})
    assert found.proposal is not None
    assert found.proposal.placement == {"a": "left", "b": "right"}


def test_what_is_reserved_is_no_room(two: Robot) -> None:
    computers = tuple(replace(c, reserve={"cpu": 0.5}) for c in two.computers)
    robot = replace(two, computers=computers)
    both = {"a": "left", "b": "left"}
    assert shortage(robot, both, computers) == pytest.approx(0.4 - 0.25)
