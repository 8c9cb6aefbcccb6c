"""Profiles of components that did not do their work."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.estimate import profiles as profile_file
from poise.model.robot import Robot
from poise.session.profiling import profile_robot
from poise.session.profiling.profile_robot import profile
from poise.session.robot_file import load_bare

ROBOT = """\
robot: silent
computers: {main: {cpu: 1, memory: 1 GiB}}
architectures:
  seeing:
    function: seeing
    components:
      blind: {implementation: "silent:Blind"}
      clock: {implementation: "silent:Clock"}
      mind: {implementation: "silent:Mind"}
    connectors:
      - {between: [blind.seen, mind.seen]}
      - {between: [clock.now, mind.now]}
profile: profile.yaml
"""
CODE = """
from poise import Component, Message, Published, every, subscribed

class Seen(Message):
    at: float

class Blind(Component):
    seen: Published[Seen]

class Clock(Component):
    now: Published[Seen]

    @every(0.05)
    def tick(self) -> None:
        self.now.publish(Seen(0.0))

class Mind(Component):
    @subscribed(keep=1)
    def seen(self, message: Seen) -> None: ...

    @subscribed(keep=1)
    def now(self, message: Seen) -> None: ...
"""


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_component_without_messages_is_said_and_not_recorded(tmp_path: Path) -> None:
    """The mind would need far more if it saw anything: no figure is better than 0."""
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "silent.py").write_text(CODE)
    robot = load_bare(tmp_path / "robot.yaml")
    found = profile(robot, seconds=1.0, warm_up=0.2, repeat=1)
    assert found.silent == {"mind": ["seen"]}
    assert found.unrecorded == ["mind"]
    written = profile_file.read(tmp_path / "profile.yaml")
    assert set(written.components) == {"blind", "clock"}
    assert set(written.connectors) == {"clock.now-mind.now"}


FAILING = CODE.replace(
    "    seen: Published[Seen]\n",
    "    seen: Published[Seen]\n\n"
    "    @every(0.05)\n"
    "    def tick(self) -> None: self.seen.publish(Seen(0.0))\n",
).replace(
    "def seen(self, message: Seen) -> None: ...",
    "def seen(self, message: Seen) -> None: raise ValueError('no map')",
)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_component_whose_work_always_fails_is_said_and_not_recorded(
    tmp_path: Path,
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "silent.py").write_text(FAILING)
    robot = load_bare(tmp_path / "robot.yaml")
    said: list[str] = []
    found = profile(robot, seconds=1.0, warm_up=0.2, repeat=1, say=said.append)
    assert found.unrecorded == ["mind"]
    assert any("component 'mind'" in s and "ValueError: no map" in s for s in said)
    assert set(found.profile.components) == {"blind", "clock"}


ASKING = """\
robot: asking
computers: {main: {cpu: 1, memory: 1 GiB}}
architectures:
  asking:
    function: asking
    components:
      asker: {implementation: "asking:Asker"}
      clock: {implementation: "asking:Clock"}
    connectors:
      - {between: [asker.hours, clock.now]}
"""
ASKING_CODE = """
import time

from poise import Component, Provided, Required, every

class Now:
    def hour(self) -> int: raise NotImplementedError

class Clock(Component):
    now: Provided[Now]

    def hour(self) -> int: return 12

class Asker(Component):
    hours: Required[Now]

    @every(0.3)
    def look(self) -> None:
        time.sleep(0.29)  # in its end, too, with high probability
        self.hours.hour()
"""


@pytest.mark.exhaustive
@pytest.mark.slow
def test_no_caller_fails_because_its_callee_ends_before_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.yaml").write_text(ASKING)
    (tmp_path / "asking.py").write_text(ASKING_CODE)
    robot = load_bare(tmp_path / "robot.yaml")
    profile(robot, seconds=1.0, warm_up=0.2, repeat=1)
    assert "ERROR" not in capfd.readouterr().err


SMALL = """\
robot: small
computers: {main: {cpu: 0.15, memory: 1 GiB}, other: {cpu: 0.15, memory: 1 GiB}}
architectures:
  asking:
    function: asking
    components:
      asker: {implementation: "small:Asker"}
      clock: {implementation: "small:Clock"}
    connectors:
      - {between: [asker.hours, clock.now]}
"""
SMALL_CODE = """
import time

from poise import Component, Provided, Required, every

class Now:
    def hour(self) -> int: raise NotImplementedError

def burn(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass

class Clock(Component):
    now: Provided[Now]

    def hour(self) -> int:
        burn(0.005)
        return 12

class Asker(Component):
    hours: Required[Now]

    @every(0.05)
    def look(self) -> None:
        burn(0.005)
        self.hours.hour()
"""


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="needs root: a quota of CPU")
def test_what_does_not_fit_on_one_computer_is_measured_at_its_own_rates(
    tmp_path: Path,
) -> None:
    """Both need 0.2 cores; the emulated computer has 0.15: for 15 calls a second."""
    (tmp_path / "robot.yaml").write_text(SMALL)
    (tmp_path / "small.py").write_text(SMALL_CODE)
    robot = load_bare(tmp_path / "robot.yaml")
    found = profile(robot, seconds=2.0, warm_up=0.5, repeat=1).profile
    calls = found.connectors["asker.hours-clock.now"].calls
    assert 16.0 < calls < 22.0


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_machine_that_gets_quicker_gives_the_cpu_of_when_it_was_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A core does 1000 loops before, 3000 after: 20 ms of a core of 2000 are 20 ms."""
    (tmp_path / "robot.yaml").write_text(SMALL.replace("0.15", "1"))
    (tmp_path / "small.py").write_text(SMALL_CODE)
    speeds = iter([1000.0, 3000.0])
    monkeypatch.setattr(profile_robot, "loops", lambda: next(speeds))
    robot = load_bare(tmp_path / "robot.yaml")
    found = profile(robot, seconds=2.0, warm_up=0.5, repeat=1).profile
    assert found.loops == 2000.0
    assert 0.05 < found.components["clock"].cpu.mean < 0.15


@pytest.mark.slow
def test_an_unknown_architecture_is_named(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "silent.py").write_text(CODE)
    robot = load_bare(tmp_path / "robot.yaml")
    with pytest.raises(UsageError, match="hearing: the robot has seeing"):
        profile(robot, architectures=["hearing"])


def test_a_robot_without_architectures_has_nothing_to_measure() -> None:
    with pytest.raises(UsageError, match="'bare' has no architectures to measure"):
        profile(Robot(name="bare"))
