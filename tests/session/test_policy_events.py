"""A recording shows what policies would have done."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

import poise
from poise.cli.robot_file_command import policy_command
from poise.errors import UsageError
from poise.manage.observe.sample_recording import RecordingFile
from poise.model.policy import SUBJECTS, ComputerValues, LinkValues, Policy, Seen
from poise.model.robot import Computer, Robot
from poise.wire.recording_file import McapFile
from tests.recordings import write_recording

BUSY = Policy(
    name="busy",
    for_each="computer",
    when="used > 80%",
    lasts=0.5,
    do="notify",
    cool_down=2.0,
    say="{name} uses {used}",
)
ROBOT = Robot(
    name="r",
    computers=(Computer(name="left", capacity={"cpu": 1.0, "memory": 1e9}),),
    policies=(BUSY,),
)


def record(path: Path, *used: float) -> None:
    """Write a recording with the use of a computer, five times a second."""
    recorder = RecordingFile(path, "r")
    for number, cores in enumerate(used):
        values = ComputerValues(name="left", used=cores)
        link = LinkValues(name="left-right", bandwidth=float("inf"))
        seen = Seen(at=1000 + number / 5, computers=(values,), links=(link,))
        recorder.add(seen)
    recorder.close()


def test_a_policy_would_have_acted_once_its_condition_lasted(tmp_path: Path) -> None:
    record(tmp_path / "x", 0.1, 0.9, 0.9, 0.9, 0.9, 0.1)
    (event,) = poise.test_policies(ROBOT, tmp_path / "x")
    assert round(event.at, 1) == 0.8  # it holds from 0.2 s on
    assert (event.policy, event.do, event.about) == ("busy", "notify", "left")
    assert event.what == "left uses 0.9 cores"
    assert msgspec.to_builtins(event.saw)["used"] == 0.9


def test_it_would_have_acted_again_after_its_cool_down(tmp_path: Path) -> None:
    record(tmp_path / "x", *[0.9] * 16)  # 3 s
    events = poise.test_policies(ROBOT, tmp_path / "x")
    assert [round(event.at, 1) for event in events] == [0.6, 2.6]


def test_a_recording_without_what_policies_see_is_refused(tmp_path: Path) -> None:
    write_recording(tmp_path / "x", "r")
    with pytest.raises(UsageError, match="`poise up --record` records it"):
        poise.test_policies(ROBOT, tmp_path / "x")


def test_a_recording_of_another_robot_is_refused(tmp_path: Path) -> None:
    record(tmp_path / "x", *[0.9] * 8)
    other = msgspec.structs.replace(ROBOT, name="other")
    with pytest.raises(UsageError, match="recorded of robot 'r', not of 'other'"):
        poise.test_policies(other, tmp_path / "x")


def test_a_damaged_recording_is_refused(tmp_path: Path) -> None:
    with McapFile(tmp_path / "x", "r") as file:
        file.add("policies", None, 1.0, b"damaged")
    with pytest.raises(UsageError, match="is damaged"):
        poise.test_policies(ROBOT, tmp_path / "x")


def test_everything_that_policies_ask_is_recorded() -> None:
    fields = {f"{subject}s" for subject in SUBJECTS}
    assert fields == {*Seen.__struct_fields__} - {"at"}


def test_the_command_prints_what_would_have_been_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "x", *[0.9] * 5)
    file = tmp_path / "robot.yaml"
    file.write_text(
        "robot: r\ncomputers: {left: {cpu: 1, memory: 1 GiB}}\n"
        "policies: {busy: {for each: computer, when: used > 80%, do: notify}}\n"
    )
    policy_command("test", file, tmp_path / "x", as_json=True)
    (event,) = msgspec.json.decode(capsys.readouterr().out)
    assert event["policy"] == "busy"
    policy_command("test", file, tmp_path / "x")
    assert "computer 'left': used > 80%" in capsys.readouterr().out
    with pytest.raises(UsageError, match="give a recording"):
        policy_command("test", file)
