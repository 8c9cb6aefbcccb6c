"""When what a change saves has been lost."""

from __future__ import annotations

import pytest

from poise.manage.adaptation.when_to_act import JUDGE_AFTER, LossSuffered


def test_a_change_is_made_when_as_much_is_lost_as_it_costs() -> None:
    loss = LossSuffered()
    loss.note(0.1, since=100.0, now=101.0)
    assert loss.lost == pytest.approx(0.1)
    assert loss.earned_at(0.3, 101.0) == pytest.approx(103.0)
    loss.note(0.1, since=100.0, now=103.0)
    assert loss.earned_at(0.3, 103.0) == 103.0


def test_what_short_bursts_take_adds_up() -> None:
    """Each is over before it takes as much as a change costs."""
    loss = LossSuffered()
    for now in (0.0, 10.0, 20.0):
        loss.note(0.1, since=now, now=now)
        loss.end(now + 1.0)
    assert loss.lost == pytest.approx(0.3)


def test_what_was_lost_long_ago_does_not_count() -> None:
    loss = LossSuffered()
    loss.note(0.1, since=0.0, now=0.0)
    loss.end(1.0)
    loss.note(0.1, since=1000.0, now=1000.0)
    assert loss.lost == 0.0


def test_what_was_lost_before_a_change_is_paid_for() -> None:
    loss = LossSuffered()
    loss.note(1.0, since=0.0, now=5.0)
    loss.note_change(undone=1.0, gain=1.0, now=5.0)
    loss.note(0.1, since=0.0, now=6.0)
    assert loss.lost == pytest.approx(0.1)


def test_what_was_lost_before_a_change_is_paid_for_also_shortly_after_an_end() -> None:
    loss = LossSuffered()
    loss.note(1.0, since=0.0, now=1.0)
    loss.end(2.0)
    loss.note(1.0, since=3.0, now=5.0)
    assert loss.lost == pytest.approx(4.0)
    loss.note_change(undone=1.0, gain=1.0, now=5.0)
    assert loss.lost == 0.0
    loss.note(0.1, since=0.0, now=6.0)
    assert loss.lost == pytest.approx(0.1)
    assert loss.lasts(since=0.0, now=6.0) == 1.0
    assert loss.lasts(since=5.5, now=6.0) == 0.5


def test_changes_that_gain_nothing_are_made_less_and_less() -> None:
    loss, now, doubts = LossSuffered(), 0.0, []
    for undone in (1.0, 1.0, 0.0, 1.0):
        loss.note_change(undone=1.0, gain=1.0, now=now)
        now += JUDGE_AFTER
        loss.judge(undone, now)
        doubts.append(loss.doubt)
    assert doubts == pytest.approx([2.0, 4.0, 4.0 / 2**0.5, 8.0 / 2**0.5])


def test_a_change_is_not_judged_before_it_is_measured() -> None:
    loss = LossSuffered()
    loss.note_change(undone=1.0, gain=1.0, now=0.0)
    loss.judge(1.0, JUDGE_AFTER / 2)
    assert loss.doubt == 1.0


def test_a_change_is_judged_once() -> None:
    loss = LossSuffered()
    loss.note_change(undone=1.0, gain=1.0, now=0.0)
    for _ in range(3):
        loss.judge(1.0, JUDGE_AFTER)
    assert loss.doubt == 2.0


def test_a_change_after_which_nothing_is_wrong_was_not_in_vain() -> None:
    loss = LossSuffered()
    loss.note_change(undone=1.0, gain=1.0, now=0.0)
    loss.judge(1.0, JUDGE_AFTER)
    loss.note_change(undone=1.0, gain=1.0, now=10.0)
    loss.end(10.0 + JUDGE_AFTER)
    assert loss.doubt == pytest.approx(2**0.5)


def test_what_moves_nothing_is_not_judged() -> None:
    """Architectures are suspended for nothing that could be compared."""
    loss = LossSuffered()
    loss.note_change(undone=0.0, gain=0.0, now=0.0)
    loss.judge(1.0, JUDGE_AFTER)
    assert loss.doubt == 1.0
