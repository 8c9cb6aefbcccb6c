"""When an input counts as lost, and as found again."""

from __future__ import annotations

from poise.runtime.execution.input_watch import InputWatch


def test_an_input_is_lost_a_moment_after_its_last_source_and_found_at_once() -> None:
    watch = InputWatch({"scan"}, 0.0)
    assert watch.note({"scan": True}, 0.5) == []
    assert not watch.is_pending()
    assert watch.note({"scan": False}, 5.0) == []
    assert watch.is_pending()
    assert watch.note({}, 5.06) == [("lost", "scan")]
    assert watch.note({}, 9.0) == []
    assert not watch.is_pending()
    assert watch.note({"scan": True}, 9.1) == [("found", "scan")]


def test_a_source_that_is_replaced_within_a_moment_is_not_lost() -> None:
    watch = InputWatch({"scan"}, 0.0)
    assert watch.note({"scan": True}, 0.5) == []
    assert watch.note({"scan": False}, 5.0) == []
    assert watch.note({"scan": True}, 5.04) == []
    assert watch.note({"scan": False}, 5.07) == []  # another gap


def test_an_input_that_nobody_joins_is_lost_after_a_second() -> None:
    watch = InputWatch({"scan"}, 10.0)
    assert watch.note({}, 10.9) == []
    assert watch.note({}, 11.01) == [("lost", "scan")]
