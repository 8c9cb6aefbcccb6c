"""A bag of ROS 2 is what a robot works on while it is profiled, and simulated."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.estimate import profiles as profile_file
from poise.model import load
from poise.model.robot import Robot
from poise.ros2.bag_player import stamped_later
from poise.session.profiling.rig import OTHERS, PLAYER, rig_of
from poise.session.robot_file import load_bare
from poise.session.simulate import simulate
from poise.wire.bag_file import Bag
from tests.bags import AGE, write_bag
from tests.command import Poise
from tests.waiting import LONG

CODE = """
import numpy as np
from numpy.typing import NDArray
from poise import Component, Message, Stamp, subscribed

class LaserScan(Message):
    stamp: Stamp
    ranges: NDArray[np.float32]

class Scanner(Component):
    @subscribed(keep=10)
    def scan(self, message: LaserScan) -> None:
        age = self.clock.since(message.stamp)
        with open(self.parameters["file"], "a") as file:
            file.write(f"{age.value} {message.ranges[-1]}\\n")
"""
ROBOT = """
robot: scanning
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
architectures:
  seeing:
    function: seeing
    components:
      scanner:
        implementation: "scanning:Scanner"
        cpu: 5%
        memory: 80 MiB
        parameters: {{file: {folder}/scans}}
tasks: {{see: {{actions: [{{name: see, functions: [seeing]}}]}}}}
ros2: {{bridges: [{{ros2: {topic}, port: scanner.scan{type}}}]}}
workload: {{recording: drive}}
profile: profile.yaml
"""
NODES = """
robot: scanning
computers: {left: {cpu: 1, memory: 1 GiB}, right: {cpu: 1, memory: 1 GiB}}
architectures:
  sensing:
    function: sensing
    components: {laser: {ros2: {executable: ./laser.py}, cpu: 5%, memory: 80 MiB}}
  seeing:
    function: seeing
    components: {scanner: {ros2: {executable: ./see.py}, cpu: 5%, memory: 80 MiB}}
connectors: [{between: [laser, scanner], topic: scan}]
tasks: {see: {actions: [{name: see, functions: [seeing, sensing]}]}}
workload: {recording: drive}
"""
BRIDGED = "scanner-scan-ros2.scan-scanner.scan"


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    (tmp_path / "scanning.py").write_text(CODE)
    write_bag(tmp_path / "drive", 20)  # 0.95 s
    return tmp_path


def robot(folder: Path, topic: str = "/scan", type_: str = "") -> Robot:
    given = f", type: {type_}" if type_ else ""
    text = ROBOT.format(folder=folder, topic=topic, type=given)
    (folder / "robot.yaml").write_text(text)
    return load_bare(folder / "robot.yaml")


def test_a_stamp_is_as_old_as_when_it_was_recorded(tmp_path: Path) -> None:
    write_bag(tmp_path / "drive", 1)
    (message,) = Bag(tmp_path / "drive").messages(["/scan"])
    later = stamped_later(message.data, 1.5)
    # 1 700 000 000 s - 20 ms + 1.5 s, behind the four bytes of the encoding
    assert int.from_bytes(later[4:8], "little") == 1_700_000_001
    nano = int.from_bytes(later[8:12], "little")
    assert nano == pytest.approx(480_000_000, abs=1000)
    assert (later[:4], later[12:]) == (message.data[:4], message.data[12:])
    none = message.data[:4] + bytes(8) + message.data[12:]
    assert stamped_later(none, 1.5) == none


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.timeout(LONG)
def test_profiles_a_component_and_its_bridge_on_a_bag(
    folder: Path, poise: Poise
) -> None:
    rig = rig_of(robot(folder), "seeing", "left", apart=False)
    assert rig.placement[PLAYER] == OTHERS
    measure = "--for", "3s", "--warm-up", "3s", "--repeat", "1"
    done = poise("profile", str(folder / "robot.yaml"), *measure)
    assert done.returncode == 0, done.stdout + done.stderr
    profile = profile_file.read(folder / "profile.yaml")
    assert {"scanner", "scanner-scan-ros2"} <= profile.components.keys()
    # 20 in 1.05 s, with the pause behind each round
    assert 0 < profile.connectors[BRIDGED].messages < 25
    lines = (folder / "scans").read_text().split("\n")[:-1]
    ages, numbers = zip(*(map(float, line.split()) for line in lines), strict=True)
    assert {*numbers} == {float(number) for number in range(20)}
    assert AGE <= sorted(ages)[len(ages) // 2] < 1.0


def test_a_bag_takes_the_place_of_nodes_that_publish_its_topics(folder: Path) -> None:
    (folder / "robot.yaml").write_text(NODES)
    rig = rig_of(load(folder / "robot.yaml"), "seeing", "left", apart=False)
    assert rig.placement == {"scanner": "left", PLAYER: OTHERS}
    played = rig.robot.component(PLAYER).parameters
    assert played["topics"] == ("/scan",)
    assert played["bag"] == str(folder / "drive")


@pytest.mark.slow
def test_simulates_what_a_bag_brings(folder: Path) -> None:
    simulated = simulate(robot(folder), seconds=60.0, recording=folder / "drive")
    # 20 in 1.05 s, with the pause behind each round: 1143 a minute
    assert simulated.messages == pytest.approx(1143, rel=0.05)


@pytest.mark.slow
def test_says_what_a_bag_lacks(folder: Path) -> None:
    with pytest.raises(UsageError) as missing:
        simulate(robot(folder, "/map"), recording=folder / "drive")
    assert str(missing.value).startswith(
        f"bag {folder / 'drive'} has no topic '/map', which scanner.scan takes. It has "
        "'/scan'."
    )
    write_bag(folder / "other", 0, kind="std_msgs/msg/Int32")
    for type_, wanted in ("", "/LaserScan"), ("sensor_msgs/msg/LaserScan",) * 2:
        says = f"has std_msgs/msg/Int32 on '/scan', and scanner.scan takes {wanted}"
        with pytest.raises(UsageError, match=says):
            simulate(robot(folder, type_=type_), recording=folder / "other")
    write_bag(folder / "empty", 0)
    with pytest.raises(UsageError, match=r"no message on '/scan', which scanner\.scan"):
        simulate(robot(folder), recording=folder / "empty")
    (folder / "robot.yaml").write_text(NODES.replace("drive}", "empty}"))
    with pytest.raises(UsageError, match="empty has nothing that comes into the rob"):
        rig_of(load(folder / "robot.yaml"), "seeing", "left", apart=False)
