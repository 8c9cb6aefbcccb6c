"""The manager says what troubles itself."""

from __future__ import annotations

from pathlib import Path
from threading import Thread

from poise.manage.journal import Journal
from poise.manage.observe.troubles import ManagerTroubles
from poise.threads import SHOWN_FOR
from tests.waiting import wait_until


class Clocks:
    wall, now = 1e9, 100.0

    def pass_by(self, seconds: float) -> None:
        self.wall += seconds
        self.now += seconds


def test_a_jump_of_the_clock_is_said_once_and_shown_for_a_minute() -> None:
    clocks, journal = Clocks(), Journal(":memory:")
    troubles = ManagerTroubles(journal, lambda: clocks.wall, lambda: clocks.now)
    clocks.pass_by(30)
    troubles.check()
    assert not troubles.deviations()
    clocks.wall -= 7200
    troubles.check()
    clocks.pass_by(59)
    troubles.check()
    (entry,) = journal.entries()
    assert "clock of the manager's computer jumped back by 7200 s" in entry.what
    assert [each.what for each in troubles.deviations()] == [entry.what]
    clocks.pass_by(2)
    troubles.check()
    assert not troubles.deviations()
    assert len(journal.entries()) == 1


def test_a_clock_that_drifts_is_no_trouble() -> None:
    clocks, journal = Clocks(), Journal(":memory:")
    troubles = ManagerTroubles(journal, lambda: clocks.wall, lambda: clocks.now)
    for _ in range(100):
        clocks.pass_by(1)
        clocks.wall += 0.1
        troubles.check()
    assert not journal.entries()


def test_of_threads_that_fail_at_once_all_are_shown() -> None:
    journal, others = Journal(":memory:"), list[Thread]()

    def wall() -> float:
        if troubles and not others:
            error = RuntimeError("bad")
            others.append(Thread(target=troubles[0].note_failure, args=("b", error)))
            others[0].start()
            others[0].join()
        return 1e9

    troubles = list[ManagerTroubles]()
    troubles.append(ManagerTroubles(journal, wall))
    troubles[0].note_failure("a", RuntimeError("bad"))
    shown = [each.what for each in troubles[0].deviations()]
    assert ["'a'" in shown[-1], "'b'" in shown[0]] == [True, True]


class File:
    trouble = ""


def test_a_file_that_cannot_be_written_is_a_deviation_meanwhile() -> None:
    file, journal = File(), Journal(":memory:")
    troubles = ManagerTroubles(journal, others=[file])
    for file.trouble in (
        "the recording x cannot be written: no room",
        "the recording x cannot be written: no room, and so far lacks 1 record",
        "the recording x cannot be written: no room, and so far lacks 7 records",
        "the recording x lacks 8 records",
    ):
        troubles.check()
        (found,) = troubles.deviations()
        assert found.what == file.trouble
    file.trouble = ""
    troubles.check()
    assert not troubles.deviations()
    assert [(e.kind, e.what) for e in journal.entries()] == [
        ("wrong", "the recording x cannot be written: no room"),
        (
            "wrong",
            "the recording x cannot be written: no room, and so far lacks 1 record",
        ),
        ("wrong", "the recording x lacks 8 records"),
        ("right", "no more: the recording x lacks 8 records"),
    ]


def test_a_journal_that_cannot_be_written_is_a_deviation(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    journal = Journal(tmp_path / "file" / "journal.jsonl")
    wait_until(lambda: journal.trouble)
    troubles = ManagerTroubles(journal)
    troubles.check()
    (found,) = troubles.deviations()
    assert found.what.endswith("cannot be written: Not a directory")
    assert [e.what for e in journal.entries()] == [found.what]
    journal.close()


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
