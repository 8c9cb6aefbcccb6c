"""What killed processes of Fast DDS leave behind, and where ROS 2 logs."""

from __future__ import annotations

import fcntl
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from poise.ros2 import ros_context
from poise.ros2.ros_context import remove_leftovers

_UNUSED, _USED, _PORT = "fastdds_" + 16 * "a", "fastdds_" + 16 * "b", "fastdds_port7000"
_NODE = """
import rclpy
rclpy.init()
node = rclpy.create_node("short_lived")
print(open("/proc/self/maps").read())
print("ready", flush=True)
input()
"""

_OURS = """
from poise.ros2 import ros_context
ros_context.join({})
node = ros_context.node_of("roomy")
print(open("/proc/self/maps").read())
node.destroy_node()
ros_context.leave()
"""


def test_segments_that_nobody_locks_are_removed(tmp_path: Path) -> None:
    for name in (_UNUSED, _USED, _PORT):
        (tmp_path / name).touch()
        (tmp_path / f"{name}_el").touch()
    with (tmp_path / f"{_USED}_el").open("rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert remove_leftovers(tmp_path, young=60.0) == []
        assert remove_leftovers(tmp_path, young=0.0) == [_UNUSED]
    kept = {_USED, f"{_USED}_el", _PORT, f"{_PORT}_el"}
    assert {path.name for path in tmp_path.iterdir()} == kept


@pytest.mark.slow
@pytest.mark.parametrize("is_users", [False, True])
def test_a_node_of_poise_has_room_for_large_messages_unless_its_user_says_otherwise(
    tmp_path: Path, *, is_users: bool
) -> None:
    own = {"FASTDDS_DEFAULT_PROFILES_FILE": str(tmp_path / "none.xml")}
    maps = subprocess.run(
        [sys.executable, "-c", _OURS],
        env={**os.environ, **(own if is_users else {})},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout
    areas = re.findall(r"^(\w+)-(\w+) .*/fastdds_[0-9a-f]{16}$", maps, re.MULTILINE)
    (size,) = (int(end, 16) - int(begin, 16) for begin, end in areas)
    # 4 MiB, or Fast DDS's 512 KiB, and what it keeps of each message
    assert (size > 4 << 20) is not is_users
    assert size < 5 << 20


@pytest.mark.slow
def test_fast_dds_locks_its_segment_until_it_is_killed() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _NODE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        said = "".join(iter(process.stdout.readline, "ready\n"))
        (segment,) = set(re.findall(r"/dev/shm/(fastdds_[0-9a-f]{16})\b", said))
        path = Path("/dev/shm") / segment
        os.utime(f"{path}_el", (0.0, 0.0))  # as if it ran for long
        assert segment not in remove_leftovers()
        assert path.exists()
        process.kill()
    assert segment in remove_leftovers()
    assert not path.exists()


@pytest.mark.slow
def test_a_process_without_a_home_joins_ros() -> None:
    code = "from poise.ros2 import ros_context as c; c.join({}); c.leave()"
    homes = ("HOME", "ROS_HOME", "ROS_LOG_DIR")
    environment = {k: v for k, v in os.environ.items() if k not in homes}
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr


def test_a_home_that_is_there_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    (name,) = ros_context.home()
    assert name in {"ROS_HOME", "ROS_LOG_DIR"}
    monkeypatch.setenv("ROS_LOG_DIR", "/somewhere")
    assert ros_context.home() == {}
