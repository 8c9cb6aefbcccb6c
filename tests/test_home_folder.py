"""A user whom no list names may run robots."""

from __future__ import annotations

import pwd
from pathlib import Path

import pytest

from poise.ros2 import ros_context
from poise.session.folders import state_folder
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
