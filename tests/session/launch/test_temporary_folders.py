"""Temporary folders go with whoever made them, though it may be killed."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.model.robot import Computer, Robot
from poise.session import nothing
from poise.session.folders import scratch_folder
from poise.session.launch.computers import emulated_agents
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

PREFIX = "poise-test-"
OWNER = f"""
import os, sys
from poise.session.folders import scratch_folder

with scratch_folder("{PREFIX}") as folder:
    (folder / "deep").mkdir()
    if "forks" not in sys.argv or os.fork():
        print(folder, flush=True)
    sys.stdin.read()
    os._exit(0)
"""


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Let temporary folders lie in one of the test's own."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return tmp_path


@contextmanager
def owner(*words: str) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """Start a process that has a folder."""
    with subprocess.Popen(
        [sys.executable, "-c", OWNER, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        yield process, Path(process.stdout.readline().strip())


def test_is_there_and_then_it_is_not(place: Path) -> None:
    with scratch_folder(PREFIX) as folder:
        (folder / "file").touch()
        assert folder.parent == place
    assert list(place.iterdir()) == []


def test_what_a_killed_process_left_is_removed_by_the_next() -> None:
    with owner() as (process, left):
        process.kill()
    assert (left / "deep").exists()
    with scratch_folder(PREFIX):
        assert not left.exists()


def test_what_somebody_has_stays() -> None:
    with owner() as (process, folder), scratch_folder(PREFIX):
        assert (folder / "deep").exists()
        process.kill()


def test_what_a_fork_of_a_killed_process_uses_stays() -> None:
    """As containers use their agent's folder, for a moment."""
    with owner("forks") as (process, left):
        process.kill()
        process.wait()
        with scratch_folder(PREFIX):
            assert (left / "deep").exists()
        assert process.stdin is not None
        process.stdin.close()  # and so the fork ends
        wait_until(lambda: _is_gone_after_the_next(left))


def _is_gone_after_the_next(left: Path) -> bool:
    with scratch_folder(PREFIX):
        return not left.exists()


def test_what_only_looks_like_one_is_left_alone(place: Path) -> None:
    other = place / "other"
    other.mkdir()
    (other / "file").touch()
    (place / f"{PREFIX}link").symlink_to(other)
    (place / f"{PREFIX}file").touch()
    with scratch_folder(PREFIX):
        assert (other / "file").exists()
    assert len(list(place.iterdir())) == 3


def test_computers_are_not_emulated_where_paths_of_sockets_are_too_long() -> None:
    robot = Robot(name="long", computers=(Computer(name="left"),))
    folder = Path("/", 90 * "x")
    with (
        pytest.raises(UsageError, match="bytes long, but sockets in a folder need one"),
        emulated_agents(robot, folder, nothing),
    ):
        pass
