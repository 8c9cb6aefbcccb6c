"""Containers that crash again and again run elsewhere, or are suspended."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.manage.adaptation.loop import Adaptation
from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.takeover import start_or_take_over
from poise.manage.shortages.suspension import CALM
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot
from poise.wire.records.status_records import AgentStatus, ContainerHealth, Fault
from tests.manage.adaptation.shortages.test_suspension import HIGH, Robbed, robot_with

SPECS = {"cpu": 1.0, "memory": 1e9}


class Crashing(Robbed):
    """A robot of two computers whose container of `low` crashes where a test says."""

    def __init__(self, robot: Robot, *computers: str) -> None:
        names = computers or ("left", "right")
        free = tuple(replace(a, home=None) for a in robot.architectures)
        robot = replace(
            robot,
            computers=tuple(Computer(name=n, capacity=SPECS) for n in names),
            architectures=free,
        )
        super().__init__(robot)
        self.crashing: set[str] = {"left"}
        self.faults: dict[str, tuple[Fault, ...]] = {}
        fault = Fault(container="low-task", message="ended with exit code 3", number=1)
        self.health = ContainerHealth(
            name="low-task",
            state="restarting",
            since=0.0,
            restarts_lately=5,
            last_fault=fault,
        )
        self.now = 0.0
        self.loop = Adaptation(
            self.run, self.facts_of_crash, self.suspensions, clock=lambda: self.now
        )

    def facts_of_crash(self) -> Situation:
        """Return that the container crashes, if it is there."""
        at = self.run.placement().get("low", "")
        status = AgentStatus(
            computer=at, generation=1, uptime=0, cpu=0, health=(self.health,)
        )
        statuses = {
            name: AgentStatus(
                computer=name, generation=1, uptime=0, cpu=0, faults=faults
            )
            for name, faults in self.faults.items()
        }
        if at in self.crashing:
            statuses[at] = status
        return replace(self.situation(), statuses=statuses)

    def look(self, times: int = 1, every: float = 1.0) -> None:
        """Let the loop look so many times."""
        for _ in range(times):
            self.now += every
            self.loop.adapt()

    def wrong(self) -> list[str]:
        """Return what the journal says is wrong."""
        return [e.what for e in self.journal.entries() if e.kind in {"wrong", "failed"}]


def test_it_runs_on_the_other_computer() -> None:
    robbed = Crashing(robot_with())
    robbed.look(300)
    assert robbed.run.placement() == {"high": "left", "low": "right"}
    assert robbed.run.placed["low"].epoch == 1
    assert not robbed.suspensions.deviations()


def test_a_new_manager_knows_where_it_crashed_under_the_one_before() -> None:
    robbed = Crashing(robot_with())
    robbed.faults["right"] = tuple(
        Fault(container="low-task", message="", uptime=0.0) for _ in range(5)
    )
    robbed.look()
    assert robbed.run.placement() == HIGH
    (deviation,) = robbed.suspensions.deviations()
    assert "again and again on 'left' and 'right'" in deviation.what


def test_what_crashes_everywhere_is_put_aside_and_stays_so() -> None:
    robbed = Crashing(robot_with())
    robbed.crashing = {"left", "right"}
    robbed.look(2)
    assert robbed.run.placement() == HIGH
    (deviation,) = robbed.suspensions.deviations()
    assert deviation.what == (
        "architecture 'low-task' is suspended: container 'low-task' crashes again and "
        "again on 'left' and 'right' (the last time: ended with exit code 3); it is "
        "resumed when its code changes, or by `poise balance`"
    )
    assert robbed.wrong()[-1] == deviation.what
    robbed.crashing = set()
    robbed.look(1000, 10.0)
    assert robbed.run.placement() == HIGH


def test_what_was_put_aside_stays_so_under_the_next_manager(tmp_path: Path) -> None:
    """It may be on a computer that has no folder of the robot, only deployed code."""
    (tmp_path / "a.py").write_text("B = object")
    robot = replace(robot_with(), deployed="1f2e", folder=str(tmp_path))
    robbed = Crashing(robot)
    robbed.crashing = {"left", "right"}
    robbed.look(2)
    robbed.run.commit(replace(robbed.run.desired, tasks=b"some"), "tasks go on")
    follower = Crashing(replace(robot, folder=str(tmp_path / "there")))
    for computer, told in robbed.agents.deployed[-2:]:
        follower.agents.begin_deploy(computer, told)
    start_or_take_over(follower.run)
    follower.suspensions.record()
    (deviation,) = follower.suspensions.deviations()
    assert "it crashed again and again wherever it may run" in deviation.what
    follower.look(100, 10.0)
    assert follower.run.placement() == HIGH
    follower.loop.balance(0.0, dry=False)
    follower.look(2, CALM)
    assert follower.run.placement().keys() == {"high", "low"}
    assert not follower.run.desired.crashed


def test_what_could_not_be_tried_elsewhere_is_not_held_to_crash_there() -> None:
    robbed = Crashing(robot_with())
    robbed.agents.lose_when_told = "right"
    robbed.look()
    assert "computer 'right' went out of reach in the meantime" in robbed.wrong()[-1]
    assert robbed.run.placement() == {"high": "left", "low": "left"}
    robbed.agents.lose_when_told = ""
    robbed.agents.gone.clear()
    robbed.look(2, 60.0)
    assert robbed.run.placement() == {"high": "left", "low": "right"}


@pytest.mark.parametrize("alone", [False, True])
def test_what_cannot_be_started_for_long_starts_elsewhere_and_is_never_suspended(
    *, alone: bool
) -> None:
    robbed = Crashing(robot_with(), *(["left"] if alone else []))
    robbed.health = replace(
        robbed.health, restarts_lately=0, reason="cannot be started: no memory is free"
    )
    robbed.look(5)
    assert robbed.run.placement() == {"high": "left", "low": "left"}
    robbed.look()
    where = "left" if alone else "right"
    assert robbed.run.placement() == {"high": "left", "low": where}
    told = "container 'low-task' on 'left' cannot be started: no memory is free"
    assert told in robbed.wrong()
    assert robbed.suspensions.deviations() == ()


def test_what_is_held_crashes_where_it_is() -> None:
    """It may be at work elsewhere: so nothing is started in its place."""
    robbed = Crashing(robot_with())
    held = replace(robbed.run.desired, held=frozenset({"low"}))
    robbed.run.commit(held, "another manager may run it")
    robbed.look()
    (wrong,) = [what for what in robbed.wrong() if what.startswith("policy")]
    assert wrong.endswith("'low-task': nothing in it is at work")
    assert robbed.run.placement() == {"high": "left", "low": "left"}


def test_it_is_taken_back_when_a_person_asks() -> None:
    robbed = Crashing(robot_with())
    robbed.crashing = {"left", "right"}
    robbed.look(2)
    robbed.crashing = set()
    robbed.loop.balance(0.0, dry=False)
    robbed.look(2, CALM)
    assert robbed.run.placement().keys() == {"high", "low"}


def test_it_is_taken_back_when_its_code_has_changed(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("B = 1")
    robbed = Crashing(replace(robot_with(), folder=str(tmp_path)))
    robbed.crashing = {"left", "right"}
    robbed.look(2)
    robbed.crashing = set()
    robbed.look(10, 60.0)
    assert robbed.run.placement() == HIGH
    (tmp_path / "a.py").write_text("B = 2")
    robbed.look(2, 10.0)
    assert robbed.run.placement().keys() == {"high", "low"}


def test_an_alternative_takes_its_place() -> None:
    robot = robot_with()
    other = Architecture(
        name="spare-task",
        function="low",
        components=(
            ComponentEntry(name="spare", implementation="a:B", demand={"cpu": 0.4}),
        ),
    )
    robbed = Crashing(replace(robot, architectures=(*robot.architectures, other)))
    robbed.crashing = {"left", "right"}
    robbed.look(2)
    assert robbed.run.placement() == HIGH
    robbed.look(3, CALM)
    assert robbed.run.placement().keys() == {"high", "spare"}


def test_where_there_is_no_other_computer_it_is_put_aside() -> None:
    robbed = Crashing(robot_with(), "left")
    robbed.look()
    assert robbed.run.placement() == HIGH


@pytest.mark.parametrize("layer", ["reactive", "deliberative"])
def test_other_layers_stay_and_that_is_said(layer: str) -> None:
    robbed = Crashing(robot_with(layer=layer))
    robbed.look(100)
    assert robbed.run.placement() == {"high": "left", "low": "left"}
    assert robbed.run.placed["low"].epoch == 0
    said = [what for what in robbed.wrong() if "its agent keeps restarting it" in what]
    assert len(said) == 2  # once a minute
    assert (
        f"component 'low' stays on 'left': it belongs to the {layer} layer" in said[0]
    )


def test_what_is_pinned_stays() -> None:
    robbed = Crashing(robot_with())
    pinned = robbed.run.robot.with_components(lambda c: replace(c, movable=False))
    robbed.run.robot = pinned
    robbed.look(100)
    assert robbed.run.placement() == {"high": "left", "low": "left"}
    assert "component 'low' stays on 'left': it is not movable" in robbed.wrong()[-1]
