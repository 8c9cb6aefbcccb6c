"""The journal: what was noted stays, in order."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.manage.journal import Journal


def test_what_was_noted_is_there_in_order() -> None:
    journal = Journal(":memory:")
    journal.note("decided", "go", placement={"a": "left"})
    journal.note("done", "went")
    told = [(e.kind, e.what, e.facts) for e in journal.entries()]
    assert told == [
        ("decided", "go", {"placement": {"a": "left"}}),
        ("done", "went", {}),
    ]
    assert journal.entries()[0].at <= journal.entries()[1].at


def test_it_outlives_its_writer(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    first = Journal(path)
    first.note("seen", "something")
    first.close()
    second = Journal(path)
    second.note("seen", "more")
    assert [e.what for e in second.entries()] == ["something", "more"]
    second.close()


def test_a_line_that_cannot_be_written_is_told_and_the_robot_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "journal.sqlite"
    journal = Journal(path)
    with contextlib.closing(sqlite3.connect(path)) as other:
        other.execute("DROP TABLE entries")
    journal.note("failed", "a wheel came off")
    assert "no such table" in caplog.text
    assert "failed: a wheel came off" in caplog.text
    journal.close()


def test_a_file_that_is_no_journal_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes"
    path.write_text("these are a user's own notes\n" * 40)
    with pytest.raises(UsageError, match=r"journal .*notes cannot be opened"):
        Journal(path)


def test_it_can_be_read_while_it_is_written(tmp_path: Path) -> None:
    writer, reader = (Journal(tmp_path / "journal.sqlite") for _ in range(2))
    writer.note("seen", "something")
    assert [e.what for e in reader.entries()] == ["something"]
    writer.close()
    reader.close()
