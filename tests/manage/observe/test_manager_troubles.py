"""The manager says what troubles itself."""

from __future__ import annotations

from pathlib import Path

from poise.manage.journal import Journal
from poise.manage.observe.troubles import ManagerTroubles
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
