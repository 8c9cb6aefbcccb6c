"""The loop rests, does not go to and fro, and keeps its budget."""

from __future__ import annotations

import random

import pytest

from poise.manage.adaptation.decision import decide
from poise.manage.adaptation.restraint import BUDGET, LONGEST_REST, Restraint
from poise.manage.migration.transition import Step
from tests.manage.adaptation.conftest import Make

AWAY = Step(kind="move", component="a", source="left", target="right")


def test_it_rests_twice_as_long_each_time() -> None:
    restraint, now, rests = Restraint(), 1000.0, []
    for _ in range(9):
        restraint.note([AWAY], now)
        began = now
        while restraint.rests(now):
            now += 0.5
        rests.append(now - began)
    assert rests == [3, 6, 12, 24, 48, 96, 192, LONGEST_REST, LONGEST_REST]


def test_after_a_long_time_it_rests_shortly_again() -> None:
    restraint = Restraint()
    for now in (0.0, 10.0, 20.0):
        restraint.note([AWAY], now)
    restraint.note([AWAY], 1000.0)
    assert not restraint.rests(1003.0)


def test_a_component_may_not_return_for_some_time() -> None:
    restraint = Restraint()
    restraint.note([AWAY], 0.0)
    assert restraint.barred(299.0) == {"a": {"left"}}
    assert restraint.barred(300.0) == {}
    restraint.note([AWAY], 400.0)
    assert restraint.barred(999.0) == {"a": {"left"}}


def test_no_more_than_the_budget_moves_in_a_minute() -> None:
    restraint = Restraint()
    restraint.note([AWAY] * BUDGET, 0.0)
    assert not restraint.may_move(1, 59.0)
    assert restraint.may_move(BUDGET, 60.0)


@pytest.mark.parametrize("load", ["periodic", "adversarial", "random"])
def test_no_load_makes_a_component_go_to_and_fro(facts: Make, load: str) -> None:
    """An hour under a load of other programs that changes sides."""
    restraint, chance = Restraint(), random.Random(1)
    placement, moves = {"a": "left", "b": "left"}, 0
    left_at: dict[tuple[str, str], int] = {}
    side = "left"
    for now in range(0, 3600, 5):
        if load == "periodic":
            side = ("left", "right")[now // 40 % 2]
        elif load == "adversarial":  # always where more components are
            at = list(placement.values())
            side = max(("left", "right"), key=at.count)
        elif chance.random() < 0.2:
            side = chance.choice(("left", "right"))
        if restraint.rests(now):
            continue
        seen = facts(dict(placement), background={side: 0.35})
        found = decide(seen, restraint.barred(now), {})
        if not found.acts or found.proposal is None:
            restraint.note_nothing(now)
            continue
        restraint.note(found.proposal.steps, now)
        for step in found.proposal.steps:
            moves += 1
            assert now - left_at.get((step.component, step.target), -300) >= 300
            left_at[step.component, step.source] = now
            placement[step.component] = step.target
    assert 1 <= moves <= 16
