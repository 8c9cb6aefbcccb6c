"""What a manager holds that another one may run on computers it has not claimed."""

from __future__ import annotations

from typing import cast

import pytest
from msgspec.structs import replace

from poise.estimate.code_version import version_of
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy import takeover
from poise.manage.deploy.adoption import authoritative, found_in, joined_by
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Desired, Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.lost_computers import LostComputers
from poise.manage.deploy.reconciler import WITNESS_LIMIT
from poise.manage.deploy.takeover import start_or_take_over
from poise.manage.journal import Journal
from poise.model.robot import Architecture, ComponentEntry, Robot
from poise.testing import VirtualClock
from poise.wire.records.deployment_records import Deployment, Goal
from poise.wire.records.migration_records import StepsDone, StepsFailed
from poise.wire.records.status_records import ComponentStatus
from tests.manage.conftest import FakeAgents

PLACEMENT = {"grabber": "left", "thinker": "right"}
GRABBER = Incarnation(component="grabber", computer="left")
THINKER = Incarnation(component="thinker", computer="right", epoch=4)


class Cut:
    """A robot that a manager takes over which reaches one of its computers.

    Parameters
    ----------
    reached
        That computer.
    left
        What an earlier manager told the agents.
    fenced
        Whether the reached computer's lease had ended.
    """

    def __init__(
        self, robot: Robot, reached: str, *left: Incarnation, fenced: bool = False
    ) -> None:
        names = [computer.name for computer in robot.computers]
        self.agents = FakeAgents(*names)
        layout = DeploymentLayout(robot, "/run", code_version=version_of)
        gateways = {name: f"{name}:7000" for name in names}
        self.told: dict[str, Deployment] = layout.deployments(
            Desired(coming=left, generation=5), gateways
        )
        for computer, deployment in self.told.items():
            self.agents.begin_deploy(computer, deployment)
        if fenced:
            status = self.agents.statuses()[reached]
            self.agents.report(replace(status, cut_off=1.0))
        self.agents.gone = {*names} - {reached}
        self.journal = Journal(":memory:")
        agents = cast("Agents", self.agents)
        self.run = LiveRobot(robot, PLACEMENT, agents, self.journal, "/run")

    def take_over(self, *, by_force: bool = False) -> None:
        start_or_take_over(self.run, by_force=by_force)
        self.lost = LostComputers(self.run)

    def goals(self, component: str) -> list[tuple[str, int, Goal]]:
        """Return what reached agents are told of a component: where, epoch, goal."""
        return sorted(
            {
                (each.computer, each.epoch, each.goal)
                for each in self.run.desired.incarnations()
                if each.component == component and each.computer not in self.agents.gone
            }
        )

    def heal(self, *found: Incarnation, robot: Robot, computer: str = "") -> None:
        """Let a computer be reached with its components; empty: the one that is not."""
        if not computer:
            (computer,) = self.agents.gone
        layout = DeploymentLayout(robot, "/run", code_version=version_of)
        self.agents.left_with[computer] = layout.deployments(
            Desired(coming=found, generation=9), {}
        )[computer]
        self.agents.strangers.add(computer)
        self.agents.gone.remove(computer)
        for _ in range(3):
            self.run.reconcile()
            self.lost.note()


def test_what_was_fenced_is_not_activated_while_a_computer_is_missing(
    robot: Robot,
) -> None:
    cut = Cut(robot, "right", GRABBER, THINKER, fenced=True)
    cut.take_over()
    assert cut.goals("thinker") == [("right", 4, "inactive")]
    (held,) = (d for d in cut.lost.deviations() if d.component == "thinker")
    assert "another manager may run it on 'left'" in held.what
    assert "--take-over" in held.what


def test_what_is_at_work_goes_on(robot: Robot) -> None:
    cut = Cut(robot, "right", GRABBER, THINKER)
    cut.take_over()
    assert cut.goals("thinker") == [("right", 4, "active")]
    assert "thinker" not in cut.run.desired.held


def test_what_is_lacking_is_not_started_twice(robot: Robot) -> None:
    cut = Cut(robot, "left", GRABBER, THINKER)
    cut.take_over()
    assert cut.goals("thinker") == []
    assert "thinker" in cut.run.desired.held


@pytest.mark.parametrize("goal", ["stay", "inactive"])
def test_one_side_of_a_migration_is_not_activated_alone(
    robot: Robot, goal: Goal
) -> None:
    cut = Cut(robot, "right", GRABBER, THINKER.with_goal(goal))
    cut.take_over()
    assert cut.goals("thinker") == [("right", 4, "inactive")]


def test_a_target_that_works_goes_on_though_its_source_is_missing(robot: Robot) -> None:
    """The manager was killed when it had committed the move, and told nobody yet."""
    cut = Cut(robot, "right", GRABBER, THINKER.with_goal("inactive"))
    cut.agents.states["thinker"] = ComponentStatus(
        name="thinker", epoch=THINKER.epoch, state="active"
    )
    cut.agents.begin_deploy("right", cut.told["right"])  # so it reports
    cut.take_over()
    assert cut.goals("thinker") == [("right", 4, "active")]
    old = replace(THINKER, computer="left", epoch=3)
    cut.heal(GRABBER, old.with_goal("stay"), robot=robot)
    assert cut.goals("thinker") == [("right", 4, "active")]


def test_a_person_may_say_that_nobody_else_runs_it(robot: Robot) -> None:
    cut = Cut(robot, "right", GRABBER, THINKER, fenced=True)
    cut.take_over(by_force=True)
    assert cut.goals("thinker") == [("right", 4, "active")]
    assert cut.lost.computers() == {"left"}


def test_force_starts_nothing_of_a_computer_that_another_one_hears(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(takeover, "LEASES_END_WITHIN", 0.0)
    cut = Cut(robot, "right", GRABBER, THINKER, fenced=True)
    cut.agents.lasting_leases, cut.agents.hearers = {"left"}, {"left": "right"}
    cut.take_over(by_force=True)
    assert cut.goals("thinker") == [("right", 4, "inactive")]
    assert any(
        "computer 'left' is out of reach, but 'right' hears it" in entry.what
        for entry in cut.journal.entries()
    )


def test_force_starts_nothing_of_a_computer_that_is_there_and_was_not_claimed(
    robot: Robot,
) -> None:
    """It was cut off as the manager claimed it: what it runs may go on there."""
    cut = Cut(robot, "left", GRABBER, THINKER)
    cut.agents.gone.clear()
    cut.agents.unclaimed = {"right"}
    cut.take_over(by_force=True)
    assert "thinker" in cut.run.desired.held
    cut.agents.gone = {"right"}
    cut.lost.note()
    assert cut.lost.computers() == frozenset()


def test_nothing_of_a_computer_that_was_never_claimed_counts_as_lost(
    robot: Robot,
) -> None:
    cut = Cut(robot, "right", GRABBER, THINKER)
    cut.take_over()
    assert cut.lost.computers() == frozenset()


def test_what_the_other_side_ran_goes_on_there_with_its_state(robot: Robot) -> None:
    cut = Cut(robot, "right", GRABBER, THINKER, fenced=True)
    cut.take_over()
    there = Incarnation(component="thinker", computer="left", epoch=7)
    cut.heal(replace(GRABBER, epoch=3), there, robot=robot)
    assert cut.goals("thinker") == [("left", 7, "active")]
    assert cut.goals("grabber") == [("left", 3, "active")]
    assert cut.run.next_epoch("thinker") == 8
    assert not cut.run.desired.held
    assert cut.run.claimed == {"left", "right"}


def test_what_joins_otherwise_than_the_file_says_is_told(robot: Robot) -> None:
    """The file was changed while its computer was out of reach."""
    now = robot.with_components(lambda c: replace(c, checkpoint=2.0))
    cut = Cut(now, "right", GRABBER, THINKER)
    cut.take_over()
    cut.heal(GRABBER, robot=robot)
    assert cut.goals("grabber") == [("left", 0, "active")]
    (told,) = [e.what for e in cut.journal.entries() if "as it was started" in e.what]
    assert "'grabber' goes on as it was started: its checkpoint changed from" in told


def test_what_nobody_ran_goes_on_where_it_was(robot: Robot) -> None:
    cut = Cut(robot, "right", GRABBER, THINKER, fenced=True)
    cut.take_over()
    cut.heal(GRABBER, robot=robot)
    assert cut.goals("thinker") == [("right", 4, "active")]


def test_what_was_taken_over_by_force_wins(robot: Robot) -> None:
    cut = Cut(robot, "right", GRABBER, THINKER, fenced=True)
    cut.take_over(by_force=True)
    there = Incarnation(component="thinker", computer="left", epoch=7)
    cut.heal(GRABBER, there, robot=robot)
    assert cut.goals("thinker") == [("right", 4, "active")]


@pytest.mark.parametrize("works", [True, False])
def test_a_move_that_was_half_done_is_committed_when_its_target_works(
    robot: Robot, *, works: bool
) -> None:
    """Its manager was killed before it told the target's agent so."""
    cut = Cut(robot, "right", GRABBER, THINKER.with_goal("stay"))
    cut.take_over()
    target = Incarnation(component="thinker", computer="left", epoch=7)
    layout = DeploymentLayout(robot, "/run", code_version=version_of)
    left = layout.deployments(
        Desired(
            coming=(GRABBER, target if works else target.with_goal("inactive")),
            generation=8,
        ),
        {},
    )
    cut.agents.begin_deploy("left", left["left"])  # so it reports
    cut.heal(GRABBER, target.with_goal("inactive"), robot=robot)
    at = ("left", 7, "active") if works else ("right", 4, "active")
    assert cut.goals("thinker") == [at]


@pytest.mark.parametrize("is_committed", [True, False])
def test_the_container_of_a_target_that_is_claimed_late_says_whether_it_counts(
    robot: Robot, *, is_committed: bool
) -> None:
    """Its agent was killed after the commit, so it is inactive: its lease has ended."""
    cut = Cut(robot, "right", GRABBER, THINKER.with_goal("stay"))
    cut.take_over()
    target = Incarnation(component="thinker", computer="left", epoch=7)
    halted = StepsDone(1, targets=(("thinker", 7),), is_committed=is_committed)
    cut.agents.halted["left"] = halted
    cut.heal(GRABBER, target.with_goal("inactive"), robot=robot)
    at = ("left", 7, "active") if is_committed else ("right", 4, "active")
    assert cut.goals("thinker") == [at]


def test_a_source_waits_for_what_the_container_of_its_target_says(robot: Robot) -> None:
    """One that says nothing for long may have gone on with the move: it counts."""
    cut = Cut(robot, "right", GRABBER, THINKER.with_goal("stay"))
    clock = cut.run.clock = VirtualClock()
    cut.take_over()
    target = Incarnation(component="thinker", computer="left", epoch=7)
    cut.agents.halted["left"] = StepsFailed(1, "it does not respond")
    cut.heal(GRABBER, target.with_goal("inactive"), robot=robot)
    told = len(cut.agents.deployed)
    clock.sleep(WITNESS_LIMIT - 0.1)
    cut.agents.gone = {"left"}  # there it cannot be asked
    cut.run.reconcile()
    cut.agents.gone.clear()
    clock.sleep(0.2)
    cut.run.reconcile()
    assert cut.goals("thinker") == [("right", 4, "inactive")]
    assert len(cut.agents.deployed) == told
    clock.sleep(WITNESS_LIMIT)
    cut.run.reconcile()
    assert cut.goals("thinker") == [("left", 7, "active")]


@pytest.mark.parametrize("is_committed", [True, False])
def test_a_source_that_works_goes_on_rather_than_its_target_that_was_found_alone(
    robot: Robot, *, is_committed: bool
) -> None:
    """The move was rolled back, and the target's agent, which was killed, not told.

    Else the source's agent has only kept what it was told long ago.
    """
    cut = Cut(robot, "right", THINKER.with_goal("inactive"))
    halted = StepsDone(1, targets=(("thinker", 4),), is_committed=is_committed)
    cut.agents.halted["right"] = halted
    cut.take_over()
    source = Incarnation(component="thinker", computer="left", epoch=3)
    cut.heal(GRABBER, source, robot=robot)
    at = ("right", 4, "active") if is_committed else ("left", 3, "active")
    assert cut.goals("thinker") == [at]


def test_what_was_moved_away_from_the_other_side_before_does_not_come_back(
    robot: Robot,
) -> None:
    """Its agent was killed, and has kept what it was told long ago."""
    cut = Cut(robot, "right", GRABBER, THINKER.with_goal("stay"))
    cut.take_over()
    there = Incarnation(component="thinker", computer="left", epoch=3)
    cut.heal(GRABBER, there, robot=robot)
    assert cut.goals("thinker") == [("right", 4, "active")]


def test_what_ended_after_it_moved_away_from_the_other_side_does_not_come_back(
    robot: Robot,
) -> None:
    """Neither there nor with the next manager, which finds all computers."""
    cut = Cut(robot, "right", GRABBER, THINKER)
    cut.take_over()
    cut.run.commit(cut.run.desired.without(["thinker"]), "no action needs it")
    there = Incarnation(component="thinker", computer="left", epoch=3)
    cut.heal(GRABBER, there, robot=robot)
    assert cut.goals("thinker") == []
    layout = DeploymentLayout(robot, "/run", code_version=version_of)
    cut.agents.begin_deploy(
        "left",
        layout.deployments(Desired(coming=(GRABBER, there), generation=1), {})["left"],
    )
    agents = cast("Agents", cut.agents)
    cut.run = LiveRobot(robot, PLACEMENT, agents, cut.journal, "/run")
    cut.take_over()
    assert ("left", 3, "active") not in cut.goals("thinker")


def test_what_runs_only_on_the_other_side_goes_on_there(robot: Robot) -> None:
    cut = Cut(robot, "right", THINKER)
    cut.take_over()
    placed = cut.run.desired.without(["grabber"])
    cut.run.commit(placed, "no task is known to need it")
    cut.heal(replace(GRABBER, epoch=3), robot=robot)
    assert cut.goals("grabber") == [("left", 3, "active")]


def test_what_may_be_at_work_somewhere_goes_on_there_though_another_joins_first(
    robot: Robot,
) -> None:
    """It counted as placed on that other one, where it never ran, as a later one."""
    middle = replace(robot.computers[0], name="middle")
    robot = replace(robot, computers=(*robot.computers, middle))
    cut = Cut(robot, "middle", replace(GRABBER, computer="middle"), THINKER)
    cut.take_over()
    cut.heal(robot=robot, computer="left")
    assert "thinker" in cut.run.desired.held
    cut.heal(THINKER, robot=robot, computer="right")
    assert cut.goals("thinker") == [("right", 4, "active")]


@pytest.mark.parametrize("together", [True, False])
def test_what_was_fenced_on_two_computers_goes_on_where_it_is_later(
    robot: Robot, *, together: bool
) -> None:
    """The first that is claimed may have been cut off while the other one took over."""
    middle = replace(robot.computers[0], name="middle")
    robot = replace(robot, computers=(*robot.computers, middle))
    layout = DeploymentLayout(robot, "/run", code_version=version_of)
    old = replace(THINKER, computer="left", epoch=3)
    told = layout.deployments(Desired(coming=(old, THINKER), generation=5), {})
    names = {"left", "right", "middle"}
    desired, claimed = Desired(placed={}), {"middle"}
    for joined in [{"left", "right"}] if together else [{"left"}, {"right"}]:
        found = found_in({name: told[name] for name in joined})
        missing = names - claimed - joined
        desired = joined_by(desired, robot, found, claimed, missing, joined)
        claimed |= joined
        if missing:
            assert desired.placed["thinker"].computer == "left"
            assert desired.held == {"thinker"}
    assert desired.placed["thinker"] == THINKER
    assert not desired.held


def test_an_architecture_on_two_computers_joins_from_one_after_the_other(
    robot: Robot,
) -> None:
    middle = replace(robot.computers[0], name="middle")
    robot = replace(robot, computers=(*robot.computers, middle))
    layout = DeploymentLayout(robot, "/run", code_version=version_of)
    heavy = Incarnation(component="heavy", computer="right")
    told = layout.deployments(Desired(coming=(GRABBER, heavy), generation=5), {})
    desired, claimed = Desired(placed={}), {"middle"}
    for computer in "left", "right":
        found = found_in({computer: told[computer]})
        missing = {"right"} - {computer}
        desired = joined_by(desired, robot, found, claimed, missing, ())
        claimed.add(computer)
    assert desired.placed == {"grabber": GRABBER, "heavy": heavy}


def test_what_an_earlier_manager_held_is_no_target_of_a_migration(robot: Robot) -> None:
    layout = DeploymentLayout(robot, "/run", code_version=version_of)
    desired = Desired(placed={"thinker": THINKER}, held=frozenset({"thinker"}))
    old = replace(THINKER, computer="left", epoch=3)
    found = found_in(
        layout.deployments(
            Desired(coming=(old, *desired.incarnations()), generation=5), {}
        )
    )
    assert {each.spec.goal for each in found} == {"active", "inactive"}
    counts = authoritative(found, robot)
    assert counts["thinker"].incarnation == THINKER


@pytest.mark.parametrize("starts", [True, False])
def test_what_another_architecture_of_its_function_takes_the_place_of_does_not_join(
    robot: Robot, *, starts: bool
) -> None:
    """Also while that only starts."""
    other = ComponentEntry(name="dreamer", implementation="mind:Dreamer")
    dream = Architecture(name="dream", function="thinking", components=(other,))
    robot = replace(robot, architectures=(*robot.architectures, dream))
    new = Incarnation(component="dreamer", computer="left", goal="inactive", epoch=9)
    placed = {"dreamer": new.with_goal("active")}
    before = Desired(coming=(new,)) if starts else Desired(placed=placed)
    layout = DeploymentLayout(robot, "/run", code_version=version_of)
    found = found_in(
        {
            "right": layout.deployments(Desired(coming=(THINKER,), generation=5), {})[
                "right"
            ]
        }
    )
    desired = joined_by(before, robot, found, {"left"}, set(), set())
    assert desired.placed == before.placed
    assert joined_by(Desired(), robot, found, {"left"}, set(), set()).placed
