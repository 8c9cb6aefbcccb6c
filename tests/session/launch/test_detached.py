"""What `poise up --detach` leaves when it fails."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from poise.errors import UsageError
from poise.model.robot import Computer, Robot
from poise.session.launch import detached
from poise.session.launch.detached import DetachedFailure, up_detached

ROBOT = Robot(name="twice", computers=(Computer(name="left", capacity={"cpu": 1.0}),))


def _touched(path: Path) -> Path:
    path.touch()
    return path


@pytest.mark.parametrize(
    ("another", "ended"), [(False, ["up", "emulate"]), (True, ["up"])]
)
def test_ends_the_computers_that_it_made_unless_another_manager_has_them(
    *,
    another: bool,
    ended: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two are started at once, and this one comes second."""
    found: list[str] = []

    def wait(process: str, *_: object) -> None:
        if process == "up":
            raise DetachedFailure("robot 'twice' runs already", 2)

    for name, fake in {
        "set_for": lambda _: None,
        "log_of": lambda name: _touched(tmp_path / name),
        "is_alive": lambda _: another,
        "_started": lambda words, _: words[0],
        "_wait": wait,
        "_end": found.append,
    }.items():
        monkeypatch.setattr(detached, name, fake)
    with pytest.raises(DetachedFailure, match="runs already"):
        up_detached(ROBOT, Path("robot.yaml"), ["up"], print, lambda: None)
    assert found == ended


def test_says_what_its_computers_are_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    made = iter([None])
    state = SimpleNamespace(without=("CPU limits",))
    kept = SimpleNamespace(state=lambda: state)
    for name, fake in {
        "set_for": lambda _: next(made, kept),
        "log_of": lambda name: _touched(tmp_path / name),
        "_started": lambda *_: SimpleNamespace(pid=1),
        "_wait": lambda *_: None,
    }.items():
        monkeypatch.setattr(detached, name, fake)
    up_detached(ROBOT, Path("robot.yaml"), ["up"], said.append, lambda: None)
    assert said[0].strip() == "without CPU limits"
    assert "stay up until" in said[1]


def test_interrupted_does_not_say_that_computers_stay_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    ended: list[int] = []
    waits = iter([None])
    keeper = SimpleNamespace(poll=lambda: None, send_signal=ended.append, wait=Mock())
    for name, fake in {
        "set_for": lambda _: None,
        "log_of": lambda name: _touched(tmp_path / name),
        "_started": lambda *_: keeper,
        "_wait": lambda *_: next(waits),
        "is_alive": lambda _: False,
    }.items():
        monkeypatch.setattr(detached, name, fake)
    with pytest.raises(StopIteration):  # as Ctrl-C does, while the robot comes up
        up_detached(ROBOT, Path("robot.yaml"), ["up"], said.append, lambda: None)
    assert ended == [signal.SIGTERM] * 2
    assert not said


def test_a_log_that_cannot_be_written_is_named_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(detached, "set_for", lambda _: None)
    with pytest.raises(
        UsageError,
        match=r"twice\.computers\.log cannot be written: Not a directory\. It is the "
        "log of .*: choose another folder by XDG_STATE_HOME",
    ):
        up_detached(ROBOT, Path("robot.yaml"), ["up"], print, lambda: None)


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="mounts a small disk")
def test_a_full_disk_is_named_when_the_reason_found_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mount = ["mount", "-t", "tmpfs", "-o", "size=4k", "full", str(tmp_path)]
    subprocess.run(mount, check=True)
    try:
        (tmp_path / "filled").write_bytes(b"x" * 4096)
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
        monkeypatch.setattr(detached, "set_for", lambda _: ROBOT)
        words = ["status", "--robot", "nobody"]
        says = r"with exit code 2; why .*: No space left on device\. Make room, or"
        with pytest.raises(DetachedFailure, match=says) as failed:
            up_detached(ROBOT, Path("robot.yaml"), words, print, lambda: None)
        assert failed.value.exit_code == 2
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)
