"""The loop rests, does not go to and fro, and keeps its budget."""

from __future__ import annotations

import random

import pytest

from poise.manage.adaptation.decision import decide
from poise.manage.adaptation.when_to_act import (
    BUDGET,
    FIRST_BACKOFF,
    LONGEST_BACKOFF,
    SETTLE,
    LossSuffered,
    MoveLimits,
    has_changed,
)
from poise.manage.migration.migration_report import TransitionStep
from tests.manage.adaptation.conftest import Make

AWAY = TransitionStep("a", "left", "right")


def test_it_rests_until_what_has_changed_is_measured() -> None:
    move_limits = MoveLimits()
    for now in (0.0, 10.0, 20.0):
        move_limits.note([AWAY], now)
        assert move_limits.is_backing_off(now + 0.9 * SETTLE)
        assert not move_limits.is_backing_off(now + SETTLE)


def test_a_component_may_not_return_for_some_time() -> None:
    move_limits = MoveLimits()
    move_limits.note([AWAY], 0.0)
    assert move_limits.quarantined(299.0) == {"a": {"left"}}
    assert move_limits.quarantined(300.0) == {}
    move_limits.note([AWAY], 400.0)
    assert move_limits.quarantined(999.0) == {"a": {"left"}}


def test_no_more_than_the_budget_moves_in_a_minute() -> None:
    move_limits = MoveLimits()
    move_limits.note([AWAY] * BUDGET, 0.0)
    assert not move_limits.may_move(1, 59.0)
    assert move_limits.may_move(BUDGET, 60.0)


@pytest.mark.parametrize("load", ["periodic", "adversarial", "random"])
def test_under_no_load_do_moves_cost_more_than_was_lost(
    situation: Make, load: str
) -> None:
    """Twenty minutes under a load of other programs that changes sides."""
    loss, chance = LossSuffered(), random.Random(1)
    placement = {"a": "left", "b": "left"}
    suffered, spent, side = 0.0, 0.0, "left"
    for now in range(0, 1200, 5):
        if load == "periodic":
            side = ("left", "right")[now // 40 % 2]
        elif load == "adversarial":  # always where more components are
            at = list(placement.values())
            side = max(("left", "right"), key=at.count)
        elif chance.random() < 0.2:
            side = chance.choice(("left", "right"))
        seen = situation(dict(placement), background={side: 0.35})
        found = decide(seen, doubt=loss.doubt)
        if not found.acts or found.proposal is None:
            loss.end(now)
            continue
        loss.judge(found.undone, now)
        loss.note(found.gain, now, now)
        suffered += 5 * found.gain
        if loss.lost >= loss.doubt * found.cost:
            spent += found.cost
            loss.note_change(found.undone, found.gain, now)
            placement |= {s.component: s.target for s in found.proposal.steps}
    assert 0 < spent <= suffered


def test_what_was_in_vain_is_thought_about_soon_when_things_have_changed() -> None:
    limits = MoveLimits()
    for now in (0.0, 2.0, 6.0, 14.0):
        limits.start_backoff(now, {"left": 1.0})
    assert limits.is_backing_off(29.0, {"left": 1.02})
    assert limits.is_backing_off(14.4, {"left": 0.5})  # but not at once
    assert not limits.is_backing_off(14.5, {"left": 0.5})


def test_when_things_have_changed_it_goes_on_to_think() -> None:
    """A change that is not worth its cost yet is looked at again and again."""
    limits = MoveLimits()
    for now in (0.0, 2.0, 6.0, 14.0):
        limits.start_backoff(now, {"left": 1.0})
    assert not limits.is_backing_off(14.5, {"left": 0.5})
    assert not limits.is_backing_off(15.0, {"left": 0.5})


def test_what_goes_wrong_next_waits_for_nothing_that_is_over() -> None:
    limits = MoveLimits()
    for now in (0.0, 2.0, 6.0, 14.0):
        limits.start_backoff(now, {"left": 1.0})
    limits.reset_backoff()
    assert not limits.is_backing_off(20.0, {"left": 1.0})


def waits(limits: MoveLimits, now: float) -> float:
    """Let it find at `now` that nothing can be done; return for how long it waits."""
    limits.start_backoff(now)
    lasts = [2.0**k for k in range(12) if limits.is_backing_off(now + 2.0**k)]
    return 2 * max(lasts, default=0.5)


def test_what_stays_in_vain_is_thought_about_less_and_less() -> None:
    limits = MoveLimits()
    assert FIRST_BACKOFF == 2.0
    assert [waits(limits, 1000.0 * k) for k in range(8)] == [
        2,
        4,
        8,
        16,
        32,
        64,
        128,
        256,
    ]
    limits.start_backoff(9000.0)
    assert limits.is_backing_off(9000.0 + 0.99 * LONGEST_BACKOFF)
    assert not limits.is_backing_off(9000.0 + LONGEST_BACKOFF)
    limits.reset_backoff()
    assert waits(limits, 10_000.0) == 2


def test_after_a_transition_it_waits_only_until_that_has_settled() -> None:
    limits = MoveLimits()
    for now in (0.0, 2.0, 6.0, 14.0):
        limits.start_backoff(now)
    limits.note([AWAY], 15.0)
    assert not limits.is_backing_off(15.0 + SETTLE)


def test_a_decision_may_be_another_when_one_of_several_amounts_has_changed() -> None:
    before = {"left": 1.0, "right": 1.0}
    assert not has_changed(before, {"left": 1.02, "right": 0.98})
    assert has_changed(before, {"left": 1.02, "right": 0.5})
    assert has_changed(before, {"left": 1.0})
    assert has_changed(before, {**before, "third": 1.0})


def test_what_stops_or_starts_again_where_it_was_may_be_there_at_once() -> None:
    limits = MoveLimits()
    stops = [TransitionStep("a", "left"), TransitionStep("c", "left")]
    limits.note([*stops, TransitionStep("c", target="left")], 0.0)
    limits.note([TransitionStep("b", target="left")], 0.0)
    assert limits.quarantined(1.0) == {}


def test_a_cool_down_is_none_the_shorter_when_things_have_changed() -> None:
    limits = MoveLimits()
    limits.start_backoff(0.0, {"left": 1.0})
    limits.note([], 2.0)
    assert limits.is_backing_off(3.9, {"left": 0.5})


def test_a_cold_move_bars_the_way_back_too() -> None:
    limits = MoveLimits()
    limits.note(
        [
            TransitionStep("a", "left"),
            TransitionStep("b", "right", "left"),
            TransitionStep("a", target="right"),
        ],
        0.0,
    )
    assert limits.quarantined(1.0) == {"a": {"left"}, "b": {"right"}}


def test_the_third_computer_of_an_intermediate_move_is_not_barred() -> None:
    limits = MoveLimits()
    limits.note(
        [
            TransitionStep("a", "left", "third"),
            TransitionStep("a", "third", "right"),
        ],
        0.0,
    )
    assert limits.quarantined(1.0) == {"a": {"left"}}
