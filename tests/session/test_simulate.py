"""A task is simulated as it is asked for, to the end or until Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import poise
from poise.errors import RunError
from poise.manage.tasks.action_placement import PlanOverTime
from poise.model.loading import load
from poise.model.robot import Robot
from poise.simulation.faults import SimulatedFault
from tests.session.fake_rehearsal import HELLO, FakeRehearsal, rehearsal
from tests.waiting import LONG

__all__ = ["rehearsal"]
CUT = SimulatedFault(at=1.0, kind="cut link", target="left", other="right", lasts=2.0)


@pytest.fixture
def hello() -> Robot:
    return load(HELLO)


class CtrlC:
    """Interrupts when it is asked the n-th time."""

    def __init__(self, at: int) -> None:
        self.left = at

    def __call__(self) -> None:
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt


def test_the_engine_gets_what_was_asked_for(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    placed = poise.place(hello, "greet", method="static")
    found = poise.simulate(
        hello, seconds=10.2, placement=placed, faults=[CUT], seed=7, adapt=False
    )
    (plan,) = rehearsal.plans
    assert (plan.tasks, plan.seconds, plan.faults) == (("greet",), 10.2, (CUT,))
    assert (plan.method, plan.adapts, plan.profile) == ("static", False, None)
    # both on the home of their architecture
    assert plan.placement == {"counter": "left", "printer": "left"}
    assert rehearsal.seeds == [7]
    assert rehearsal.closed == 1
    assert found.seconds == pytest.approx(10.2)
    assert not found.is_early


def test_later_actions_take_what_was_learned_too(
    tmp_path: Path,
    rehearsal: type[FakeRehearsal],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also in a run: it asks the planner with the robot that it gives its manager."""
    file = tmp_path / "robot.yaml"
    file.write_text("""
robot: learner
computers: {one: {cpu: 1, memory: 1 GiB}}
architectures:
  see: {function: seeing, components: {eye: {command: "true", cpu: 0.1}}}
  ear: {function: hearing, components: {ear: {command: "true", cpu: 0.1}}}
  mic: {function: hearing, quality: 50%, components: {mic: {command: "true", cpu: 0.1}}}
tasks:
  work: {actions: [{name: a, functions: [seeing]}, {name: b, functions: [hearing]}]}
""")
    robot = load(file)
    for _ in range(3):
        poise.note_outcome(robot, "b", "failed", ["ear"])
    given: list[Robot] = []

    def end(robot: Robot, *_: object) -> None:
        given.append(robot)
        raise RunError

    monkeypatch.setattr("poise.session.run.first_phase", end)
    with pytest.raises(RunError):
        poise.run(robot, seconds=1.0)
    poise.simulate(robot, seconds=1.0)
    given += [plan.robot for plan in rehearsal.plans]
    assert [
        PlanOverTime(each).placement("work", ("b",), ("hearing",)) for each in given
    ] == [{"mic": "one"}] * 2


def test_without_a_placement_poise_decides(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    assert poise.simulate(hello, seconds=1.0).method == "auto"
    (plan,) = rehearsal.plans
    assert plan.placement.keys() == {"counter", "printer"}


def test_a_watcher_sees_virtual_time_pass(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    assert not rehearsal.plans
    seen: list[float] = []
    poise.simulate(hello, seconds=1.2, meanwhile=seen.append)
    assert seen == pytest.approx([0.5, 1.0, 1.2])  # steps of 0.5 s, and the rest


def test_it_ends_when_a_defect_keeps_time_from_passing(
    hello: Robot, rehearsal: type[FakeRehearsal], monkeypatch: pytest.MonkeyPatch
) -> None:
    advance = FakeRehearsal.advance

    def stuck(self: FakeRehearsal, seconds: float) -> None:
        if self.now < 5.0:
            advance(self, seconds)

    monkeypatch.setattr(rehearsal, "advance", stuck)
    assert poise.simulate(hello, seconds=60.0).seconds == 5.0


def test_ctrl_c_gives_what_is_known_so_far(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    # it is asked once before the robot comes up, then before each step
    found = poise.simulate(hello, seconds=60.0, check=CtrlC(at=3))
    assert (found.asked, found.seconds) == (60.0, 1.0)
    assert found.is_early
    assert "1 s of 1 min of virtual time, then it was ended early" in str(found)
    assert rehearsal.closed == 1


def test_ctrl_c_does_not_reach_what_is_simulated(
    hello: Robot, rehearsal: type[FakeRehearsal], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Simulated code would take it for an error of its own, and go on."""
    advance = FakeRehearsal.advance

    def interrupted(self: FakeRehearsal, seconds: float) -> None:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            advance(self, seconds)
        except KeyboardInterrupt:
            pytest.fail("the simulated code was interrupted")

    monkeypatch.setattr(rehearsal, "advance", interrupted)
    before = signal.getsignal(signal.SIGINT)
    assert poise.simulate(hello, seconds=60.0).seconds == 0.5
    assert signal.getsignal(signal.SIGINT) is before is signal.default_int_handler


def test_ctrl_c_before_the_robot_is_up_is_raised(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        poise.simulate(hello, check=CtrlC(at=0))
    assert rehearsal.closed == 0  # nothing was begun


def test_a_robot_that_does_not_come_up_is_an_error_and_leaves_nothing(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    rehearsal.fails = "auto"
    with pytest.raises(poise.RunError, match="'printer' did not come up"):
        poise.simulate(hello)
    assert rehearsal.closed == 1


def test_without_its_extra_it_says_how_to_get_it(
    hello: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "poise.simulation.rehearsal", None)
    with pytest.raises(poise.UsageError, match=r"pip install 'poise\[simulate\]'"):
        poise.simulate(hello)


@pytest.mark.slow
def test_faults_are_named_and_files_read_without_the_extra() -> None:
    code = """
import sys
sys.modules["greenlet"] = None
import poise, poise.cli.simulate_command
poise.simulate, poise.SimulatedFault(at=1.0, kind="kill agent", target="left")
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=LONG)


@pytest.mark.slow
def test_what_does_not_fit_is_suspended_and_its_task_goes_on(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("""
robot: full
computers: {one: {cpu: 1, memory: 1 GiB}}
architectures:
  see: {function: seeing, priority: 2, components: {eye: {command: "true", cpu: 0.8}}}
  hear: {function: hearing, components: {ear: {command: "true", cpu: 0.8}}}
tasks: {work: {actions: [{name: do, functions: [seeing, hearing]}]}}
""")
    found = poise.simulate(poise.load(file), seconds=2.0)
    assert found.placement == {"eye": "one"}
    assert [task.state for task in found.tasks] == ["going"]


@pytest.mark.slow
def test_a_choice_takes_the_step_for_which_the_robot_is_placed(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("""
robot: choosy
computers: {one: {cpu: 1, memory: 1 GiB}}
architectures:
  see: {function: seeing, quality: 40%, components: {eye: {command: "true", cpu: 0.1}}}
  hear: {function: hearing, components: {ear: {command: "true", cpu: 0.1}}}
tasks:
  work:
    actions:
      - choice:
          - {name: look, functions: [seeing]}
          - {name: listen, functions: [hearing]}
""")
    found = poise.simulate(poise.load(file), seconds=1.0)
    assert found.placement == {"ear": "one"}
    (task,) = found.tasks
    assert [action.name for action in task.actions] == ["listen"]


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("inf"), float("nan")])
def test_a_simulation_takes_time(seconds: float, hello: Robot) -> None:
    with pytest.raises(poise.UsageError, match="must last longer than 0 s"):
        poise.simulate(hello, seconds=seconds)


def test_a_wrong_fault_stops_it_before_it_begins(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    late = SimulatedFault(at=60.0, kind="kill agent", target="lefd")
    with pytest.raises(poise.UsageError) as error:
        poise.simulate(hello, seconds=60.0, faults=[late])
    assert "begins at 60 s, but 60 s are simulated" in str(error.value)
    assert "there is no computer 'lefd' (did you mean 'left'?)" in str(error.value)
    assert rehearsal.plans == []


def test_all_placements_are_compared_under_the_same_seed_and_faults(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    said: list[str] = []
    found = poise.compare_simulations(
        hello,
        methods=["auto", "static", "auto"],
        seconds=600.0,
        faults="random",
        seed=3,
        say=said.append,
    )
    assert said == [
        "task 'greet' starts, with priority 0",
        "simulating auto placement",
        "simulating static placement",
    ]
    assert list(found.results) == ["auto", "static"]
    assert rehearsal.seeds == [3, 3]
    first, second = rehearsal.plans
    assert first.faults == second.faults != ()
    assert not found.failed


def test_a_placement_that_does_not_come_up_does_not_end_the_comparison(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    rehearsal.fails = "static"
    found = poise.compare_simulations(hello, methods=["static", "auto"], seconds=1.0)
    assert list(found.results) == ["auto"]
    assert found.without == {"static": "'printer' did not come up"}
    assert found.failed
    assert "static: 'printer' did not come up" in str(found)


def test_ctrl_c_in_a_comparison_keeps_what_is_known(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    # the first asks 3 times: before it comes up, and before each of two steps; the
    # second is in its second step
    found = poise.compare_simulations(
        hello, methods=["auto", "static", "greedy"], seconds=1.0, check=CtrlC(at=5)
    )
    assert {name: each.seconds for name, each in found.results.items()} == {
        "auto": 1.0,
        "static": 0.5,
    }
    assert "static was ended after 500 ms of 1 s" in str(found)
    assert len(rehearsal.plans) == 2


def test_an_unknown_method_stops_the_comparison_before_it_begins(
    hello: Robot, rehearsal: type[FakeRehearsal]
) -> None:
    with pytest.raises(poise.UsageError, match="no method 'best'"):
        poise.compare_simulations(hello, methods=["auto", "best"])
    assert rehearsal.plans == []


def test_nothing_to_compare_is_an_error(hello: Robot) -> None:
    with pytest.raises(poise.UsageError, match="name the placements"):
        poise.compare_simulations(hello, methods=[])
