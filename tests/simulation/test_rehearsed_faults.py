"""What faults and defects do to a robot that a user rehearses."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from poise.errors import RunError
from poise.session.robot_file import load
from poise.simulation.faults import SimulatedFault, SimulatedFaultKind
from poise.simulation.rehearsal import Rehearsal, RehearsalPlan
from poise.simulation.robot.simulated_robot import SimulatedRobot
from poise.simulation.scheduler import SimulationError

HELLO = Path(__file__).parents[2] / "examples/hello/robot.yaml"


def plan(*faults: SimulatedFault) -> RehearsalPlan:
    return RehearsalPlan(
        robot=load(HELLO),
        placement={"counter": "left", "printer": "right"},
        method="auto",
        tasks=("greet",),
        faults=faults,
    )


@pytest.mark.slow
def test_what_is_killed_misses_no_deadlines_afterwards() -> None:
    """10 Hz for 5 s, of which a restart takes a little."""
    kill = SimulatedFault(1.0, "kill container", "left")
    with closing(Rehearsal(plan(kill))) as rehearsal:
        rehearsal.come_up()
        rehearsal.advance(5.0)
        (timer,) = rehearsal.report().timers
        assert 40 <= timer.due <= 50
        assert timer.missed <= 5


@pytest.mark.slow
def test_a_disk_is_full_until_the_last_fault_is_over() -> None:
    long = SimulatedFault(0.5, "full disk", "left", lasts=5.0)
    short = SimulatedFault(1.0, "full disk", "left", lasts=0.5)
    with closing(Rehearsal(plan(long, short))) as rehearsal:
        rehearsal.come_up()
        rehearsal.advance(5.0)
        assert rehearsal._robot.disks["left"].trouble()
        rehearsal.advance(1.0)
        assert not rehearsal._robot.disks["left"].trouble()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["kill agent", "restart computer"])
def test_an_agent_starts_when_the_last_fault_that_ended_it_is_over(
    kind: SimulatedFaultKind,
) -> None:
    long = SimulatedFault(0.5, kind, "right", lasts=5.0)
    short = SimulatedFault(1.0, "kill agent", "right", lasts=0.5)
    with closing(Rehearsal(plan(long, short))) as rehearsal:
        rehearsal.come_up()
        rehearsal.advance(5.0)
        assert "right" not in rehearsal._robot.agents
        rehearsal.advance(1.0)
        assert "right" in rehearsal._robot.agents


@pytest.mark.slow
def test_what_starts_on_a_computer_that_stands_still_does_so_too() -> None:
    long = SimulatedFault(0.5, "pause computer", "right", lasts=5.0)
    short = SimulatedFault(1.0, "kill agent", "right", lasts=0.5)
    with closing(Rehearsal(plan(long, short))) as rehearsal:
        rehearsal.come_up()
        rehearsal.advance(5.0)
        agent = rehearsal._robot.agents["right"]
        assert agent.process.is_paused
        rehearsal.advance(1.0)
        assert not agent.process.is_paused


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["kill manager", "another manager"])
def test_no_manager_starts_without_power(kind: SimulatedFaultKind) -> None:
    """A killed one starts when there is power, and goes on with the robot."""
    long = SimulatedFault(0.5, "restart computer", "right", lasts=5.0)
    short = SimulatedFault(1.0, kind, "right", lasts=0.5)
    with closing(Rehearsal(plan(long, short))) as rehearsal:
        rehearsal.come_up()
        rehearsal.advance(5.0)
        assert len(rehearsal._robot.managers) == 1
        rehearsal.advance(15.0)
        assert rehearsal._robot.manager
        assert rehearsal._robot.manager.manager


@pytest.mark.slow
def test_a_defect_before_the_robot_is_up_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(_: SimulatedRobot) -> list[str]:
        raise SimulationError("a thread broke")

    monkeypatch.setattr("poise.simulation.rehearsal.unsettled", broken)
    with (
        closing(Rehearsal(plan())) as rehearsal,
        pytest.raises(RunError, match=r"does not come up: .*a thread broke"),
    ):
        rehearsal.come_up()


@pytest.mark.slow
@pytest.mark.parametrize("lasts", [0.3, 0.5, 0.9])
@pytest.mark.parametrize("after", [0.001, 0.2])
def test_a_move_right_after_a_short_cut_waits_for_what_was_cut_off(
    lasts: float, after: float
) -> None:
    """0.9 s: the agent's lease has ended, and its component rests until it is told."""
    cut = SimulatedFault(1.0, "isolate computer", "left", lasts=lasts)
    with closing(Rehearsal(plan(cut))) as rehearsal:
        rehearsal.come_up()
        rehearsal.advance(1.0 + lasts + after)
        assert rehearsal.move("counter", "right").committed
