"""What a run says: warnings once, with a count."""

from __future__ import annotations

from poise.manage.journal import JournalEntry
from poise.session.run import Warnings


def test_says_the_same_warning_once_and_counts_it() -> None:
    said: list[str] = []
    warnings = Warnings(said.append)
    first = "timer 'look' missed 2 of 9 deadlines within 1 s"
    again = "timer 'look' missed 4 of 8 deadlines within 1 s"
    other = "timer 'turn' missed 2 of 9 deadlines within 1 s"
    warnings.hear(JournalEntry(0.0, "wrong", first, {}))
    warnings.hear(JournalEntry(1.0, "right", f"no more: {first}", {}))
    warnings.hear(JournalEntry(2.0, "wrong", again, {}))
    warnings.hear(JournalEntry(3.0, "wrong", other, {}))
    warnings.hear(JournalEntry(0.0, "done", "moved", {}))
    assert [each.partition(" ")[2] for each in said] == [first, other]
    warnings.end()
    assert said[2:] == [f"2 times: {first}"]


def test_names_that_differ_in_a_figure_are_not_the_same() -> None:
    said: list[str] = []
    warnings = Warnings(said.append)
    names = "arm1", "arm2", "arm-1", "arm-2", "arm_1"
    texts = [f"timer 'look' of '{name}' missed 2 of 9 deadlines" for name in names]
    for text in texts:
        warnings.hear(JournalEntry(0.0, "wrong", text, {}))
    assert [each.partition(" ")[2] for each in said] == texts
