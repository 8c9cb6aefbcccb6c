"""`poise journal` shows what a manager wrote."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.manage.journal import Journal, read_journal
from poise.session.folders import make_journal
from tests.command import POISE, Poise

pytestmark = pytest.mark.slow


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "journal.jsonl"
    book = Journal(path)
    book.note("wrong", "computer 'left' is overloaded", load=0.5)
    book.note("decided", "1 move", gain=3.0)
    book.note("done", "moved component 'a' from 'left' to 'right'")
    book.close()
    return path


def test_shows_kind_time_and_sentence(file: Path, poise: Poise) -> None:
    lines = poise("journal", file).stdout.splitlines()
    assert [line.split()[0] for line in lines] == ["wrong", "decided", "done"]
    assert lines[0].endswith("computer 'left' is overloaded")


def test_chooses_by_kind_and_by_what_it_is_about(file: Path, poise: Poise) -> None:
    assert len(poise("journal", file, "--kind", "decided").stdout.splitlines()) == 1
    about = poise("journal", file, "--about", "left").stdout.splitlines()
    assert len(about) == 2
    assert len(poise("journal", file, "--last", "1").stdout.splitlines()) == 1
    assert '"gain": 3.0' in poise("journal", file, "--facts").stdout


def test_prints_json(file: Path, poise: Poise) -> None:
    entries = json.loads(poise("journal", file, "--json").stdout)["entries"]
    assert [each["number"] for each in entries] == [1, 2, 3]
    assert entries[0]["facts"] == {"load": 0.5}


def test_follows_what_is_written(file: Path) -> None:
    argv = [*POISE, "journal", str(file), "--follow", "--last", "1"]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "moved component" in process.stdout.readline()
        book = Journal(file)
        book.note("right", "all is well")
        book.close()
        assert "all is well" in process.stdout.readline()
        process.terminate()
    assert process.returncode in {143, -15}


def test_without_a_file_it_shows_the_last_robot_or_the_one_that_is_named(
    tmp_path: Path, poise: Poise, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert "there is no journal in" in poise("journal").stderr
    for at, robot in enumerate(("first", "last")):
        path = make_journal(robot)
        book = Journal(path)
        book.note("decided", f"{robot} decided")
        book.close()
        os.utime(path, (at, at))
    shown = poise("journal", "--kind", "decided")
    assert shown.stdout.endswith(" last decided\n")
    assert "journal of robot 'last' until 1970-01-01 " in shown.stderr
    assert "first decided" in poise("journal", "--robot", "first").stdout
    refused = poise("journal", "--robot", "odd")
    assert refused.returncode == 2
    assert "no journal of robot 'odd'" in refused.stderr
    assert "there: first, last" in " ".join(refused.stderr.split())
    assert poise("journal", path, "--robot", "last").returncode == 2
    book = Journal(make_journal("first", tmp_path / "given"))
    book.note("decided", "the given one decided")
    book.close()
    assert poise("journal").stdout.endswith(" the given one decided\n")
    for at, robot in enumerate(("first", "second", "last", "third")):
        make_journal(robot, tmp_path / "given")
        link = tmp_path / "poise" / robot / "journal-given"
        os.utime(link, (at % 3, at % 3), follow_symlinks=False)
    assert "journal of robot 'last' " in poise("journal").stderr
    (tmp_path / "given").unlink()
    assert "first decided" in poise("journal", "--robot", "first").stdout


def test_refuses_what_is_no_journal(file: Path, tmp_path: Path, poise: Poise) -> None:
    (tmp_path / "text").write_text("no database")
    for name in ("text", "nowhere"):
        done = poise("journal", tmp_path / name)
        assert done.returncode == 2
        assert "cannot be read" in done.stderr
    assert poise("journal", file, "--kind", "odd").returncode == 2
    with pytest.raises(UsageError):
        read_journal(tmp_path / "nowhere")
