"""Where the files of a user are, whoever that is and however full the disk."""

from __future__ import annotations

import os
import pwd
import resource
import tempfile
from pathlib import Path

import pytest

from poise.ros2 import ros_context
from poise.session.folders import agent_folder, state_folder
from poise.user_folders import temporary_folder
from poise.wire import robots_here
from poise.wire.credentials import find


def test_a_user_without_home_and_name_has_the_folders_of_a_login(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unknown(user: int) -> pwd.struct_passwd:
        raise KeyError(user)

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR", "XDG_DATA_HOME", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert state_folder() == Path("/.local/state/poise")
    assert find("nobodys-robot", "agent") is None
    assert ros_context.home()


def test_a_full_disk_hides_no_robot_that_runs_and_no_folder_of_its_agents(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        assert robots_here.folder() == tmp_path / f"poise-{os.getuid()}"
        assert agent_folder("hello left").parent == tmp_path
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_temporary_folder_that_is_not_there_is_not_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "nothing"))
    assert temporary_folder() == Path("/tmp")
