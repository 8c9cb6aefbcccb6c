"""A file that grows in the background delays nobody, and says what it lacks."""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.manage import background_file
from poise.manage.background_file import BackgroundFile
from poise.manage.journal import Journal, read_journal
from tests.waiting import wait_until

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="mounts a small disk")


def test_a_disk_that_does_not_answer_delays_nobody_and_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(background_file, "_SLOW_AFTER", 0.0)
    monkeypatch.setattr(BackgroundFile, "close_limit", 0.0)
    path = tmp_path / "x"
    os.mkfifo(path)  # to open it waits for a reader
    file = BackgroundFile(path, "the file", "line", most=20)
    file.start()
    for _ in range(3):
        file.add(b"8 bytes\n")
    wait_until(lambda: "its disk has not answered for 0 s" in file.trouble)
    assert file.trouble.endswith("and so far lacks 1 line")
    reader = path.open("rb")
    wait_until(lambda: file.trouble == f"the file {path} lacks 1 line")
    assert reader.read(16) == b"8 bytes\n" * 2
    reader.close()
    file.close()


def test_closing_does_not_wait_for_a_disk_that_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BackgroundFile, "close_limit", 0.01)
    path = tmp_path / "x"
    os.mkfifo(path)
    file = BackgroundFile(path, "the file", "line", most=20)
    file.add(b"8 bytes\n")
    file.start()
    file.close()
    assert file.missing == 1
    path.open("rb").close()


@pytest.fixture(name="disk")
def _disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a disk of 256 KiB."""
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "small", str(tmp_path)], check=True
    )
    yield tmp_path
    subprocess.run(["umount", str(tmp_path)], check=True)


@needs_root
@pytest.mark.slow
def test_a_full_disk_costs_lines_and_not_the_robot(disk: Path) -> None:
    other = disk / "other"
    journal = Journal(disk / "journal.jsonl")
    journal.note("seen", "before")
    wait_until(lambda: journal.file and not journal.file._waiting)
    other.write_bytes(bytes(200 << 10))
    for _ in range(10):
        journal.note("seen", "x" * 10_000)
    wait_until(lambda: "cannot be written: No space left on device" in journal.trouble)
    assert len(journal.entries()) == 11
    other.unlink()
    wait_until(lambda: not journal.trouble)
    journal.note("done", "room again")
    journal.close()
    kept = [len(each.what) for each in read_journal(disk / "journal.jsonl")]
    assert kept == [len("before"), *[10_000] * 10, len("room again")]


@needs_root
@pytest.mark.slow
def test_a_journal_goes_on_when_its_disk_is_not_read_only_any_more(disk: Path) -> None:
    remount = ["mount", "-o"]
    subprocess.run([*remount, "remount,ro", str(disk)], check=True)
    journal = Journal(disk / "journal.jsonl")
    journal.note("seen", "kept in memory")
    wait_until(lambda: "cannot be written: Read-only file system" in journal.trouble)
    assert [each.what for each in journal.entries()] == ["kept in memory"]
    subprocess.run([*remount, "remount,rw", str(disk)], check=True)
    wait_until(lambda: not journal.trouble)
    journal.close()
    kept = [each.what for each in read_journal(disk / "journal.jsonl")]
    assert kept == ["kept in memory"]


@pytest.mark.slow
def test_its_thread_ends_with_it(tmp_path: Path) -> None:
    file = BackgroundFile(tmp_path / "x", "the file", "line", most=20)
    file.start()
    file.add(b"line\n")
    file.close()
    assert "the file" not in {each.name for each in threading.enumerate()}
    assert (tmp_path / "x").read_bytes() == b"line\n"
