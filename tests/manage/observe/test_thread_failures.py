"""An exception that ends a thread of the manager is seen."""

from __future__ import annotations

from poise.manage.journal import Journal
from poise.manage.observe.troubles import ManagerTroubles
from poise.threads import SHOWN_FOR


def test_a_failure_is_journalled_with_its_traceback_and_shown_for_a_minute() -> None:
    now = [100.0]
    journal = Journal(":memory:")
    troubles = ManagerTroubles(journal, now=lambda: now[0])
    troubles.note_failure("metrics", KeyError("cpu"))
    now[0] += SHOWN_FOR - 1
    troubles.note_failure("control", OSError("no descriptor"))
    first, second = (entry.what for entry in journal.entries())
    assert "thread 'metrics' of the manager's process failed (KeyError" in first
    assert [each.what for each in troubles.deviations()] == [first, second]
    assert "KeyError: 'cpu'" in journal.entries()[0].facts["traceback"]
    now[0] += 2
    assert [each.what for each in troubles.deviations()] == [second]


def test_a_thread_that_fails_again_and_again_is_shown_once() -> None:
    journal = Journal(":memory:")
    troubles = ManagerTroubles(journal)
    for number in range(30):
        troubles.note_failure("keeper", ValueError(number))
    (shown,) = troubles.deviations()
    assert "ValueError: 29" in shown.what
    assert len(journal.entries()) == 30


def test_threads_without_number_are_shown_up_to_a_bound() -> None:
    troubles = ManagerTroubles(Journal(":memory:"))
    for number in range(30):
        troubles.note_failure(f"client {number}", ValueError(number))
    assert len(troubles.deviations()) == 20
