"""The journal: what was noted stays, in order."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.manage.journal import Journal, read_journal


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


def test_a_full_disk_costs_lines_and_not_the_robot(tmp_path: Path) -> None:
    shown: list[str] = []
    journal = Journal(tmp_path / "journal.sqlite", lambda e: shown.append(e.what))
    assert journal._database is not None
    limit = journal._database.execute
    limit("PRAGMA max_page_count = 1")
    for _ in range(3):
        journal.note("seen", "x" * 10_000)
    assert "cannot be written: database or disk is full" in journal.trouble
    limit("PRAGMA max_page_count = 1000")
    journal.note("seen", "room again")
    assert not journal.trouble
    back = "the journal is written again; 3 entries are missing"
    assert [e.what for e in journal.entries()] == ["room again", back]
    assert shown[:3] == ["x" * 10_000] * 3
    journal.close()


@pytest.mark.parametrize("left", [b"", b"SQLite format 3\0", bytes(20)])
def test_a_damaged_file_is_put_aside_and_a_new_one_begun(
    tmp_path: Path, left: bytes
) -> None:
    path = tmp_path / "journal.sqlite"
    path.write_bytes(left + b"no pages of a database" * 500)
    shown: list[str] = []
    journal = Journal(path, lambda entry: shown.append(entry.what))
    journal.note("done", "begun")
    assert [e.what for e in journal.entries()] == [*shown[:1], "begun"]
    assert "the journal was damaged" in shown[0]
    assert (tmp_path / "journal.sqlite.damaged-1").read_bytes().startswith(left)
    assert not journal.trouble
    journal.close()


def test_a_file_that_is_damaged_while_it_is_written_is_put_aside(
    tmp_path: Path,
) -> None:
    path = tmp_path / "journal.sqlite"
    first = Journal(path)
    for number in range(300):
        first.note("seen", f"{number}" * 100)
    first.close()
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xff" * 100_000)
    journal = Journal(path)
    journal.note("done", "went on")
    whats = [entry.what for entry in journal.entries()]
    assert whats[-1] == "went on"
    assert "damaged" in whats[0]
    journal.close()


def test_a_file_that_was_removed_is_begun_again(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    journal = Journal(path)
    journal.note("seen", "before")
    for file in tmp_path.iterdir():
        file.unlink()
    journal.note("done", "went on")
    whats = [entry.what for entry in read_journal(path)]
    assert "was removed: a new one begins" in whats[0]
    assert whats[1:] == ["went on"]
    journal.close()


def test_a_file_that_cannot_be_one_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"the journal .*nowhere/j cannot be written"):
        Journal(tmp_path / "nowhere" / "j")
    (tmp_path / "notes").write_text("buy milk, and then more milk, and some bread " * 9)
    with pytest.raises(UsageError, match=r"notes cannot be written: file is not a da"):
        Journal(tmp_path / "notes")
