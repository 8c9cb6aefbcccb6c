"""The journal: what was noted stays, in order."""

from __future__ import annotations

from pathlib import Path

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
