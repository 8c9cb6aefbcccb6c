"""The journal: what was noted stays, in order, and no trouble of it stops a robot."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable
from pathlib import Path
from threading import Thread

import pytest

from poise.errors import UsageError
from poise.manage import journal as journals
from poise.manage.journal import (
    FILES,
    MOST_KEPT,
    Journal,
    JournalEntry,
    check_journal,
    read_journal,
)
from tests.waiting import LIMIT, wait_until


def whats(path: Path) -> list[str]:
    return [entry.what for entry in read_journal(path)]


def test_what_was_noted_is_there_in_order() -> None:
    journal = Journal(":memory:")
    journal.note("decided", "go", placement={"a": "left"})
    journal.note("done", "went")
    told = [(e.kind, e.what, e.facts) for e in journal.entries()]
    assert told == [
        ("decided", "go", {"placement": {"a": "left"}}),
        ("done", "went", {}),
    ]
    assert [e.what for e in journal.entries(after=1)] == ["went"]
    assert [e.what for e in journal.entries(most=1)] == ["went"]


def test_it_outlives_its_writer_and_numbers_go_on(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    for what in ("something", "more"):
        journal = Journal(path)
        journal.note("seen", what, load=0.5)
        journal.close()
    entries = read_journal(path)
    assert [(e.number, e.what, e.facts) for e in entries] == [
        (1, "something", {"load": 0.5}),
        (2, "more", {"load": 0.5}),
    ]
    assert [e.what for e in read_journal(path, after=1)] == ["more"]


def test_numbers_go_on_after_an_entry_that_is_long(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    for what in ("short", "long " * 50_000, "next"):
        journal = Journal(path)
        journal.note("seen", what)
        journal.close()
    assert [entry.number for entry in read_journal(path)] == [1, 2, 3]


def test_a_moment_that_is_none_can_be_shown() -> None:
    assert str(JournalEntry(1e300, "seen", "odd", {})) == "1e+300 s odd"


def test_it_can_be_read_while_it_is_written(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.note("seen", "something")
    wait_until(lambda: journal.file and not journal.file._waiting)
    assert whats(tmp_path / "journal.jsonl") == ["something"]
    journal.close()


def test_who_asks_does_not_wait_for_who_is_shown_an_entry() -> None:
    """A terminal that takes nothing holds up no status."""
    asked: list[int] = []

    def show(_: JournalEntry) -> None:
        asker = Thread(target=lambda: asked.append(len(journal.recent())), daemon=True)
        asker.start()
        asker.join(LIMIT)

    journal = Journal(":memory:", show)
    journal.note("seen", "a component")
    assert asked == [1]


def test_memory_holds_the_last_entries_only() -> None:
    journal = Journal(":memory:")
    for _ in range(MOST_KEPT + 1):
        journal.note("seen", "x")
    assert [journal.entries()[0].number, len(journal.entries())] == [2, MOST_KEPT]
    assert journal.forgotten == 1


def test_who_asks_for_no_entries_gets_none() -> None:
    journal = Journal(":memory:")
    journal.note("seen", "one")
    journal.note("seen", "two")
    assert journal.entries(most=0) == []
    assert [entry.what for entry in journal.entries(most=1)] == ["two"]


def test_its_files_rotate_and_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journals, "LARGEST", 1_000)
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    for number in range(1, 101):
        journal.note("seen", f"{number:->100}")
        wait_until(lambda: journal.file and not journal.file._waiting)
    journal.close()
    sizes = {each.name: each.stat().st_size for each in tmp_path.iterdir()}
    assert len(sizes) == FILES
    assert max(sizes.values()) <= 1_000
    kept = read_journal(path)
    assert [e.number for e in kept] == list(range(101 - len(kept), 101))
    assert len(kept) > 3 * (FILES - 1)


def test_each_line_is_json_though_managers_follow_each_other(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    for what in ("first", "second"):
        journal = Journal(path)
        journal.note("seen", what)
        journal.close()
    lines = path.read_text().splitlines()
    assert [json.loads(line)["what"] for line in lines] == ["first", "second"]


@pytest.mark.parametrize("left", [b'{"at":1.0,"kind":"se', b'{"at"\n\xff\n'])
def test_half_a_line_of_a_killed_manager_is_left_out_and_said(
    tmp_path: Path, left: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "journal.jsonl"
    first = Journal(path)
    first.note("seen", "before")
    first.close()
    with path.open("ab") as file:
        file.write(left)
    second = Journal(path)
    second.note("seen", "after")
    second.close()
    with caplog.at_level(logging.WARNING):
        assert whats(path) == ["before", "after"]
    assert "without a journal entry" in caplog.text


def test_a_fact_that_json_refuses_is_said_once_and_the_robot_goes_on(
    tmp_path: Path,
) -> None:
    shown: list[str] = []
    path = tmp_path / "journal.jsonl"
    journal = Journal(path, lambda entry: shown.append(entry.what))
    for _ in range(2):
        journal.note("done", "moved", fact=object())
    journal.note("done", "said \udc80")
    journal.close()
    assert whats(path)[0] == "moved"
    assert "the facts of a journal entry are lost: TypeError" in whats(path)[1]
    assert whats(path)[2:] == ["moved", "said ?"]
    assert shown == whats(path)
    assert "the facts of a journal entry are lost" in journal.trouble


def test_a_terminal_that_fails_stops_nothing(tmp_path: Path) -> None:
    def fail(entry: JournalEntry) -> None:
        raise ValueError(entry.what)

    journal = Journal(tmp_path / "journal.jsonl", fail)
    journal.note("seen", "something")
    journal.close()
    assert whats(tmp_path / "journal.jsonl") == ["something"]


def no_folder(folder: Path) -> Callable[[], object]:
    folder.touch()
    return folder.unlink


def a_folder_of_its_name(folder: Path) -> Callable[[], object]:
    (folder / "journal.jsonl").mkdir(parents=True)
    return (folder / "journal.jsonl").rmdir


@pytest.mark.parametrize("hinder", [no_folder, a_folder_of_its_name])
def test_it_goes_on_when_it_can_be_written_again(
    tmp_path: Path, hinder: Callable[[Path], Callable[[], object]]
) -> None:
    path = tmp_path / "folder" / "journal.jsonl"
    relieve = hinder(path.parent)
    journal = Journal(path)
    journal.note("seen", "kept in memory")
    wait_until(lambda: journal.trouble)
    assert f"the journal {path} cannot be written: " in journal.trouble
    assert [e.what for e in journal.entries()] == ["kept in memory"]
    relieve()
    journal.note("seen", "room again")
    journal.close()
    assert whats(path) == ["kept in memory", "room again"]


def test_a_file_that_was_removed_is_begun_again(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.note("seen", "before")
    wait_until(lambda: journal.file and not journal.file._waiting)
    path.unlink()
    journal.note("done", "went on")
    journal.close()
    assert whats(path) == ["went on"]


def test_a_step_of_the_time_of_day_by_ten_years_changes_no_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.note("seen", "before")
    monkeypatch.setattr(journals, "wall_time", lambda: 1e9)  # in 2001
    journal.note("seen", "after")
    journal.close()
    assert whats(tmp_path / "journal.jsonl") == ["before", "after"]
    assert [e.what for e in journal.entries(after=1)] == ["after"]


def test_a_file_that_can_be_no_journal_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"the journal .*nowhere/j cannot be written"):
        check_journal(tmp_path / "nowhere" / "j")
    (tmp_path / "notes").write_text("buy milk, and then more milk, and some bread")
    with pytest.raises(UsageError, match=r"notes cannot be written: the file is some"):
        check_journal(tmp_path / "notes")
    with pytest.raises(UsageError, match=r"cannot be written: Is a directory"):
        check_journal(tmp_path)
    check_journal(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_who_may_not_read_it_is_told(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read: No such file"):
        read_journal(tmp_path / "nowhere")
    (tmp_path / "text").write_text("no journal")
    with pytest.raises(UsageError, match="cannot be read: it is not a journal"):
        read_journal(tmp_path / "text")
    os.truncate(tmp_path / "text", 0)
    assert read_journal(tmp_path / "text") == []
