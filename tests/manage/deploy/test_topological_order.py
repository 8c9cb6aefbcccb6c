"""Callers before those whom they call, by hand."""

from __future__ import annotations

from poise.manage.deploy.deactivation import levels


def test_each_comes_before_all_to_which_it_leads() -> None:
    leads = [("a", "b"), ("b", "c"), ("x", "c")]
    assert levels(["c", "b", "x", "a"], leads) == [["x", "a"], ["b"], ["c"]]


def test_others_on_the_way_count() -> None:
    assert levels(["c", "a"], [("a", "other"), ("other", "c")]) == [["a"], ["c"]]


def test_those_that_lead_to_each_other_are_together() -> None:
    leads = [("a", "b"), ("b", "a"), ("b", "c")]
    assert levels(["c", "b", "a"], leads) == [["b", "a"], ["c"]]


def test_nothing_has_no_levels() -> None:
    assert levels([], [("a", "b")]) == []
