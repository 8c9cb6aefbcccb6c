"""A run is recorded, and its recording feeds an architecture that is measured alone."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.errors import UsageError
from poise.estimate import profiles as profile_file
from poise.model import load
from poise.model.robot import Generated, Robot, Workload
from poise.session.profiling.rig import OTHERS, PLAYER, played, rig_of
from poise.session.record_run import tapped
from poise.session.robot_file import check
from poise.wire.recording_file import Input, inputs_of, samples_of
from tests.command import Poise
from tests.recordings import write_recording

ROBOT = """\
robot: heard
computers:
  main: {cpu: 0.3, memory: 1 GiB}
architectures:
  hearing:
    function: hearing
    components: {ear: {implementation: "hearing:Ear", cpu: 1%, memory: 30 MiB}}
  thinking:
    function: thinking
    components: {mind: {implementation: "hearing:Mind", cpu: 1%, memory: 30 MiB}}
connectors: [{between: [ear.heard, mind.heard]}]
tasks: {think: {actions: [{name: think, functions: [hearing, thinking]}]}}
profile: profile.yaml
"""
CODE = """
from poise import Component, Message, Published, every, subscribed

class Heard(Message):
    text: str

class Ear(Component):
    heard: Published[Heard]

    @every(0.05)
    def listen(self) -> None:
        self.heard.publish(Heard("w" * 500))

class Mind(Component):
    @subscribed(keep=5)
    def heard(self, message: Heard) -> None:
        self.measure("length", len(message.text))
"""
MADE_UP = """\
workload: {generate: {mind.heard: {rate: 40 Hz, size: 1200 B}}}
"""


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "hearing.py").write_text(CODE)
    return tmp_path


@pytest.fixture(name="robot")
def _robot(folder: Path) -> Robot:
    sys.modules.pop("hearing", None)
    return load(folder / "robot.yaml")


def recorded(folder: Path, source: str) -> Workload:
    entry = Input(source, 0.1, b"", b"")
    (folder / "run.mcap").unlink(missing_ok=True)
    write_recording(folder / "run.mcap", "heard", [entry])
    return Workload(recording="run.mcap")


def test_what_goes_between_architectures_is_recorded(
    robot: Robot, tmp_path: Path
) -> None:
    tap = tapped(robot, {"ear", "mind"}, tmp_path / "inputs")
    assert (tap.sources, tap.callers) == (("ear.heard",), ())
    assert [each.record for each in tap.robot.connectors] == [str(tmp_path / "inputs")]


def test_a_message_to_several_is_recorded_once(robot: Robot, tmp_path: Path) -> None:
    twice = replace(robot, connectors=robot.connectors * 2)
    tap = tapped(twice, {"ear", "mind"}, tmp_path / "inputs")
    assert tap.sources == ("ear.heard",)
    assert [bool(each.record) for each in tap.robot.connectors] == [True, False]


def test_nothing_is_recorded_where_nothing_goes_from_one_to_another(
    robot: Robot, tmp_path: Path
) -> None:
    tap = tapped(robot, {"ear"}, tmp_path / "inputs")
    assert (tap.robot, tap.sources) == (robot, ())


def test_who_was_recorded_need_not_run(robot: Robot, folder: Path) -> None:
    busy = replace(robot, workload=recorded(folder, "ear.heard"))
    rig = rig_of(busy, "thinking", "main", apart=False)
    assert rig.placement == {"mind": "main", PLAYER: OTHERS}
    assert [str(c) for c in rig.robot.connectors] == [f"{PLAYER}.output_0-mind.heard"]
    assert rig.played == {"ear.heard-mind.heard": f"{PLAYER}.output_0-mind.heard"}


CALLING = """\
robot: heard
computers: {main: {cpu: 1, memory: 1 GiB}}
architectures:
  asking: {function: ask, components: {asker: {implementation: "asking:Asker"}}}
  also: {function: also, components: {other: {implementation: "asking:Asker"}}}
  knowing: {function: know, components: {sage: {implementation: "asking:Sage"}}}
connectors:
  - {between: [asker.answers, sage.answers]}
  - {between: [other.answers, sage.answers]}
tasks: {think: {actions: [{name: think, functions: [ask, also, know]}]}}
"""
ANSWERS = """
from typing import Protocol
from poise import Component, Provided, Required

class Answers(Protocol):
    def answer(self, number: int) -> int: ...

class Asker(Component):
    answers: Required[Answers]

class Sage(Component):
    answers: Provided[Answers]

    def answer(self, number: int) -> int:
        return number
"""


def test_who_calls_is_answered_although_its_calls_were_recorded(folder: Path) -> None:
    (folder / "robot.yaml").write_text(CALLING)
    (folder / "asking.py").write_text(ANSWERS)
    calls = [Input(f"{name}.answers", 0.1, b"", b"") for name in ("asker", "other")]
    write_recording(folder / "run.mcap", "heard", calls)
    workload = Workload(recording="run.mcap")
    busy = replace(load(folder / "robot.yaml"), workload=workload)
    rig = rig_of(busy, "asking", "main", apart=False)
    assert rig.placement == {"asker": "main", "sage": OTHERS, PLAYER: OTHERS}
    assert [str(each) for each in rig.robot.connectors] == [
        "asker.answers-sage.answers",
        f"{PLAYER}.output_0-sage.answers",
    ]
    ports = rig.robot.component(PLAYER).parameters["ports"]
    assert ports["output_0"]["sources"] == ("other.answers",)
    rig = rig_of(busy, "knowing", "main", apart=False)
    assert rig.placement == {"sage": "main", PLAYER: OTHERS}
    ports = rig.robot.component(PLAYER).parameters["ports"]
    assert ports["output_0"]["sources"] == ("asker.answers", "other.answers")


def test_what_is_generated_wins_over_what_was_recorded(
    robot: Robot, folder: Path
) -> None:
    (mind,) = (c for c in robot.connectors)
    made = Generated(port=mind.between[1], rate=5.0)
    both = replace(recorded(folder, "ear.heard"), generate=(made,))
    (part,) = played(replace(robot, workload=both)).parts.values()
    assert (part.generated, part.sources, part.type) == (made, (), "hearing:Heard")


def test_says_what_is_wrong_with_a_recording(robot: Robot, folder: Path) -> None:
    with pytest.raises(UsageError, match="`poise run --record` writes a recording"):
        played(replace(robot, workload=Workload(recording="none")))
    with pytest.raises(UsageError, match=r"to another: `poise run --record` records"):
        played(replace(robot, workload=recorded(folder, "nose.smelt")))
    other = replace(robot, name="other", workload=recorded(folder, "ear.heard"))
    with pytest.raises(UsageError, match="was recorded of robot 'heard', not of 'othe"):
        played(other)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("workload", "says"),
    [
        ("{}", "the workload is empty"),
        ("{generate: {nose.x: {rate: 1 Hz}}}", "there is no component 'nose'"),
        ("{generate: {mind: {rate: 1 Hz}}}", "give the port, as in mind.scan"),
        ("{generate: {mind.herd: {rate: 1 Hz}}}", "subscribes to no 'herd'"),
        ("{generate: {ear.heard: {rate: 1 Hz}}}", "subscribes to no 'heard'"),
        ("{generate: {mind.heard: {rate: 0 Hz}}}", "rate"),
        ("{generate: {mind.heard: {}}}", "rate"),
    ],
)
def test_check_tells_what_is_wrong_with_a_workload(
    folder: Path, workload: str, says: str
) -> None:
    (folder / "robot.yaml").write_text(f"{ROBOT}workload: {workload}\n")
    sys.modules.pop("hearing", None)
    problems = check(folder / "robot.yaml")
    assert any(says in problem.message for problem in problems), problems


@pytest.mark.exhaustive
@pytest.mark.slow
def test_measures_on_what_was_recorded_and_on_what_is_made_up(
    folder: Path, poise: Poise
) -> None:
    run = poise(
        "run", "robot.yaml", "--task", "think", "--for", "3s", "--record", "a.mcap"
    )
    assert "messages of ear.heard to a.mcap" in run.stdout, run.stdout + run.stderr
    assert list(samples_of(folder / "a.mcap"))
    inputs = inputs_of(folder / "a.mcap")
    assert {entry.source for entry in inputs} == {"ear.heard"}
    assert not (folder / "a.mcap.inputs").exists()
    measure: tuple[str, ...] = (
        "profile",
        "robot.yaml",
        "--architecture",
        "thinking",
        "--for",
        "2s",
    )
    measure += ("--warm-up", "1s", "--repeat", "1")
    found = {}
    for workload in ("workload: {recording: a.mcap}\n", MADE_UP):
        (folder / "robot.yaml").write_text(ROBOT + workload)
        done = poise(*measure)
        assert done.returncode == 0, done.stdout + done.stderr
        profile = profile_file.read(folder / "profile.yaml")
        found[workload] = profile.connectors["ear.heard-mind.heard"]
    played_, made = found.values()
    # 20 Hz but for the pause after each round; how late they come is the machine's
    assert 0 < played_.messages < 22
    assert played_.size == pytest.approx(530, abs=30)
    assert 0 < made.messages < 45
    assert made.size == pytest.approx(1224, abs=30)
