"""The journal: what was noted stays, in order."""

from __future__ import annotations

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


def test_it_can_be_read_while_it_is_written(tmp_path: Path) -> None:
    writer, reader = (Journal(tmp_path / "journal.sqlite") for _ in range(2))
    writer.note("seen", "something")
    assert [e.what for e in reader.entries()] == ["something"]
    writer.close()
    reader.close()


def test_a_full_disk_costs_lines_and_not_the_robot(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    limit = journal._database.execute
    limit("PRAGMA max_page_count = 1")
    for _ in range(3):
        journal.note("seen", "x" * 10_000)
    limit("PRAGMA max_page_count = 1000")
    journal.note("seen", "room again")
    assert [e.what for e in journal.entries()] == ["room again"]
    assert caplog.text.count("not in the journal (database or disk is full)") == 3
    assert f"seen: {'x' * 10_000}" in caplog.text
    journal.close()


def test_a_file_that_cannot_be_one_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"the journal .*nowhere/j cannot be written"):
        Journal(tmp_path / "nowhere" / "j")
    (tmp_path / "notes").write_text("buy milk, and then more milk, and some bread " * 9)
    with pytest.raises(UsageError, match=r"notes cannot be written: file is not a da"):
        Journal(tmp_path / "notes")
