"""The files of running robots in /tmp outlive what removes old files there."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest

from poise.errors import RunError
from poise.runtime.agent.agent_files import AgentFolder
from poise.wire.robots_here import AgentAddresses, folder, note, running_here


def is_cleaned(place: Path) -> bool:
    """Return whether systemd-tmpfiles would look into a folder."""
    opened = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(opened)
    return True


def test_notes_stay_while_who_wrote_them_lives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("first", "second"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / name))
        folder().mkdir(parents=True)
        assert is_cleaned(folder())
        note(AgentAddresses("hello", {}))
        assert not is_cleaned(folder())


def test_the_folder_of_another_user_is_named_with_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert not running_here()
    tmp_path.chmod(0)
    is_root = os.geteuid() == 0
    if is_root:
        os.seteuid(65534)
    try:
        with pytest.raises(RunError, match="Permission denied: set XDG_RUNTIME_DIR"):
            running_here()
    finally:
        if is_root:
            os.seteuid(0)
        tmp_path.chmod(0o700)


def test_nobody_answers_from_a_folder_that_another_user_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    folder().mkdir()
    assert not running_here()
    user = os.getuid()
    folder().rename(tmp_path / f"poise-{user + 1}")
    monkeypatch.setattr(os, "getuid", lambda: user + 1)
    with pytest.raises(RunError, match="another user's: set XDG_RUNTIME_DIR"):
        running_here()


def test_what_an_agent_keeps_stays_while_it_lives(tmp_path: Path) -> None:
    assert is_cleaned(tmp_path)
    AgentFolder(tmp_path)
    assert not is_cleaned(tmp_path)
