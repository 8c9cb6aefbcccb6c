"""A part of the manager's parts that raises stops nothing else, and is said."""

from __future__ import annotations

import pytest

from poise.errors import RunError, TakenOver
from poise.manage.journal import Journal
from poise.manage.observe.troubles import FIRST_PAUSE, LONGEST_PAUSE, ManagerParts
from poise.testing import VirtualClock


class Rig:
    """A parts with one part that fails while a test says so."""

    def __init__(self) -> None:
        self.clock, self.journal = VirtualClock(), Journal(":memory:")
        self.bugs: list[str] = []
        self.is_ending = False
        self.parts = ManagerParts(
            self.journal, self.clock, self.bugs.append, lambda: self.is_ending
        )
        self.error: Exception | None = KeyError("odd")
        self.runs = 0

    def work(self) -> str:
        self.runs += 1
        if self.error is not None:
            raise self.error
        return "done"

    def run(self, seconds: float = 0.0) -> object:
        self.clock.sleep(seconds)
        return self.parts.run("count", self.work, changes=True)

    def sentences(self) -> list[tuple[str, str]]:
        return [(entry.kind, entry.what) for entry in self.journal.entries()]


def test_a_bug_is_journalled_with_its_traceback_and_is_a_deviation() -> None:
    rig = Rig()
    assert rig.run() is None
    (entry,) = rig.journal.entries()
    assert entry.kind == "failed"
    assert "the manager cannot count (KeyError: 'odd')" in entry.what
    assert "in work" in entry.facts["traceback"]
    (deviation,) = rig.parts.deviations()
    assert deviation.what in entry.what
    assert rig.bugs == [deviation.what]


def test_a_part_that_raised_backs_off_and_comes_back() -> None:
    rig = Rig()
    rig.run()
    rig.run(FIRST_PAUSE / 2)
    assert rig.runs == 1
    rig.run(FIRST_PAUSE)
    assert rig.runs == 2
    rig.run(1.5 * FIRST_PAUSE)  # twice as long now
    assert rig.runs == 2
    rig.error = None
    assert rig.run(FIRST_PAUSE) == "done"
    assert rig.parts.deviations() == []
    assert rig.sentences()[-1] == ("right", "the manager can count again")


def test_it_is_tried_at_least_once_a_minute() -> None:
    rig = Rig()
    for _ in range(20):
        rig.run(LONGEST_PAUSE)
    assert rig.runs == 20


def test_other_parts_go_on() -> None:
    rig = Rig()
    rig.run()
    assert rig.parts.run("add", lambda: 3) == 3


def test_what_the_world_breaks_is_no_bug() -> None:
    rig = Rig()
    rig.error = RunError("no agent")
    rig.run()
    assert rig.bugs == []
    assert "(no agent)" in rig.parts.deviations()[0].what


def test_what_an_end_interrupts_is_no_failure() -> None:
    rig = Rig()
    rig.error, rig.is_ending = RunError("the robot is being stopped"), True
    rig.run()
    assert rig.parts.deviations() == []


def test_a_takeover_passes_through() -> None:
    rig = Rig()
    rig.error = TakenOver("another manager")
    with pytest.raises(TakenOver):
        rig.run()
