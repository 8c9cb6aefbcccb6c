"""What makes the manager think about another placement, and what does not."""

from __future__ import annotations

from poise.manage.adaptation.triggers import (
    LastingSymptoms,
    Symptom,
    deadlines,
    overload,
)
from tests.manage.adaptation.conftest import Make


def test_a_full_computer_whose_components_are_late_is_overloaded(facts: Make) -> None:
    seen = facts(background={"left": 0.2}, missed=("a",))
    (found,) = overload(seen)
    assert found.what == (
        "computer 'left' is overloaded: 0.50 of 0.50 cores are used, 0.20 of them by "
        "other programs"
    )


def test_a_full_computer_that_keeps_its_deadlines_is_not(facts: Make) -> None:
    assert not list(overload(facts(background={"left": 0.2})))


def test_a_late_component_on_an_idle_computer_is_no_overload(facts: Make) -> None:
    assert not list(overload(facts(missed=("a",))))


def test_a_timer_that_misses_deadlines_is_named(facts: Make) -> None:
    (found,) = deadlines(facts(missed=("b",)))
    assert found.what == (
        "timer 'tick' of component 'b' on 'left' missed 5 of 10 deadlines within 1 s"
    )


def test_only_what_lasts_counts() -> None:
    lasting, one = LastingSymptoms(0.5), Symptom("overload", "left", "left", "it is")
    assert lasting.select([one], 10.0) == ()
    assert lasting.select([one], 10.4) == ()
    assert lasting.select([one], 10.5) == (one,)
    assert lasting.select([], 10.6) == ()
    assert lasting.select([one], 10.7) == ()  # it begins again
