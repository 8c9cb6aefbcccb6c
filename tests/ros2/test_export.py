"""What a launch file starts is a node of ROS 2, with its name and parameters."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from poise.model import load
from poise.session.ros2_export import launch_files
from tests.session.test_ros2_export import WHERE, actions_of, write


@pytest.mark.slow
def test_a_class_is_a_process_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = launch_files(load(write(tmp_path)), WHERE).texts["left"]
    _, talker, *_ = actions_of(text, tmp_path / "left.launch.py", monkeypatch)
    program, *arguments = talker["cmd"]
    assert program == "python3"
    ended = subprocess.run(
        [sys.executable, *arguments],
        cwd=talker["cwd"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.stdout == "mouth 10.0\n", ended.stderr
