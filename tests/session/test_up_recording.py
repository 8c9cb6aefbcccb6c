"""`--record` keeps the recording before: it may be of what broke."""

from __future__ import annotations

from pathlib import Path

import pytest

import poise
from poise.errors import RunError, UsageError
from poise.manage.observe.sample_recording import RecordingFile
from poise.model.robot import Robot
from poise.session.record_run import keeping, new_recording
from poise.wire.records.status_records import AgentSample


def test_the_recording_before_stays_beside_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    for _ in range(2):
        new_recording(path, "r").close()
        assert path.stat().st_size
    assert (tmp_path / "run-before.mcap").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_a_run_keeps_the_recording_before_too(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"the only one")
    with keeping(Robot(name="r"), (), path, lambda _: None):
        pass
    assert (tmp_path / "run-before.mcap").read_bytes() == b"the only one"


def test_what_a_run_could_not_record_is_known_when_it_is_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(*_: object) -> None:
        raise RunError("the disk is full")

    monkeypatch.setattr(RecordingFile, "write", write)
    path, said = tmp_path / "run.mcap", list[str]()
    with keeping(Robot(name="r"), (), path, said.append) as kept:
        assert kept.recorder is not None
        kept.recorder.add(AgentSample("left", 1.0, 0.0, ()))
    assert kept.lacks.endswith("the disk is full, and so far lacks 1 record")
    assert kept.lacks in said[0]


def test_one_that_cannot_be_renamed_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.touch()
    (tmp_path / "run-before.mcap").mkdir()
    with pytest.raises(UsageError, match="cannot be renamed: Is a directory"):
        new_recording(path, "r")


ROBOT = """
robot: unrecorded
computers: {left: {cpu: 1, memory: 1 GiB}}
architectures:
  idle:
    function: rest
    components: {idle: {command: sleep 1, cpu: 1%, memory: 1 MiB}}
tasks: {rest: {actions: [{name: rest, functions: [rest]}]}}
"""


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["record", "journal"])
def test_nothing_is_said_to_start_and_no_recording_made_where_a_file_cannot_be(
    tmp_path: Path, missing: str
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    files = {"record": tmp_path / "run.mcap", "journal": tmp_path / "journal"}
    files[missing] = tmp_path / "none" / "file"
    said: list[str] = []
    robot = poise.load(tmp_path / "robot.yaml")
    with (
        pytest.raises(UsageError, match="none/file cannot be"),
        poise.up(
            robot,
            record=files["record"],
            journal=files["journal"],
            say=said.append,
        ),
    ):
        pass
    assert said == []
    assert [path.name for path in tmp_path.iterdir()] == ["robot.yaml"]
