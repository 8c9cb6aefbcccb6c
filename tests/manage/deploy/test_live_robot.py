"""A run against agents that do what the test says."""

from __future__ import annotations

import re
from typing import Any, cast

import pytest
from msgspec import structs

from poise.errors import RunError
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.model.robot import Robot
from poise.testing import VirtualClock
from poise.wire.records.request_records import CheckpointCopy, Election
from poise.wire.records.status_records import ComponentStatus, Fault
from tests.manage.conftest import FakeAgents

PLACEMENT = {"grabber": "left", "thinker": "right"}


def run_of(robot: Robot, agents: FakeAgents) -> tuple[LiveRobot, Journal]:
    journal = Journal(":memory:")
    return LiveRobot(robot, PLACEMENT, cast("Agents", agents), journal, "/run"), journal


@pytest.fixture
def agents() -> FakeAgents:
    return FakeAgents("left", "right")


def goals(agents: FakeAgents) -> list[tuple[str, list[Any]]]:
    return [
        (computer, [c.goal for spec in told.containers for c in spec.components])
        for computer, told in agents.deployed
    ]


def test_starts_everything_inactive_first(robot: Robot, agents: FakeAgents) -> None:
    run, journal = run_of(robot, agents)
    run.start()
    assert sorted(goals(agents)[:2]) == [
        ("left", ["inactive"]),
        ("right", ["inactive"]),
    ]
    assert sorted(goals(agents)[2:]) == [("left", ["active"]), ("right", ["active"])]
    assert journal.entries()[-1].facts == {"placement": PLACEMENT}


def test_stops_everything(robot: Robot, agents: FakeAgents) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    stop(run)
    assert all(not status.containers for status in agents.statuses().values())


def test_begins_after_what_the_agents_saw_from_another_manager(robot: Robot) -> None:
    agents = FakeAgents("left", "right", generation=41)
    run, _ = run_of(robot, agents)
    run.start()
    assert min(told.generation for _, told in agents.deployed) == 42


def test_a_component_that_fails_ends_the_start_with_its_traceback(
    robot: Robot, agents: FakeAgents
) -> None:
    agents.states["grabber"] = ComponentStatus(
        name="grabber", state="failed", error="Traceback: no camera"
    )
    run, journal = run_of(robot, agents)
    with pytest.raises(
        RunError, match="component 'grabber' on 'left' failed:\nTraceback: no"
    ):
        run.start()
    assert journal.entries()[-1].what == "component 'grabber' on 'left' failed"


def test_what_is_not_there_in_time_is_named(robot: Robot, agents: FakeAgents) -> None:
    agents.states["thinker"] = ComponentStatus(name="thinker", state="unconfigured")
    known = Fault(container="eye", message="was killed long ago", number=3)
    agents.note_faults(known)
    run, _ = run_of(robot, agents)
    new = Fault(container="mind", message="was killed by SIGSEGV", number=4)
    agents.faults = (known, new)
    with pytest.raises(RunError) as caught:
        run.start()
    says = "component 'thinker' on 'right' is unconfigured, not yet inactive (do its"
    assert says in str(caught.value)
    assert "container 'mind' on 'right' was killed by SIGSEGV" in str(caught.value)
    assert "long ago" not in str(caught.value)


def test_a_silent_agent_is_named(robot: Robot, agents: FakeAgents) -> None:
    agents.deaf.add("right")
    run, _ = run_of(robot, agents)
    with pytest.raises(RunError, match="computer 'right' is silent"):
        run.start()


def test_an_agent_that_refuses_ends_the_start(robot: Robot, agents: FakeAgents) -> None:
    agents.refusing.add("right")
    run, _ = run_of(robot, agents)
    with pytest.raises(RunError, match="'right' refused: not today"):
        run.start()


def test_a_lost_computer_is_said_at_once_and_may_be_back(
    robot: Robot, agents: FakeAgents
) -> None:
    """On a small board an agent may stand still for a moment as the robot starts."""
    run, journal = run_of(robot, agents)
    run.clock = clock = VirtualClock()
    run.start()
    agents.gone.add("right")
    run.watch(0.0)
    said = r"'right' has been out of reach since .*thinker stops"
    assert re.search(said, journal.entries()[-1].what)
    clock.sleep(9.0)
    run.watch(0.0)
    agents.gone.clear()
    run.watch(0.0)
    assert journal.entries()[-1].kind == "right"
    agents.gone.add("right")
    run.watch(0.0)
    clock.sleep(11.0)
    with pytest.raises(RunError, match=said):
        run.watch(0.0)


def test_stops_the_others_when_one_refuses(robot: Robot, agents: FakeAgents) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    agents.refusing.add("left")
    with pytest.raises(RunError, match="'left' refused"):
        stop(run)
    assert not agents.statuses()["right"].containers


def test_what_does_not_stop_is_named(robot: Robot, agents: FakeAgents) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    agents.deaf.add("left")
    with pytest.raises(RunError, match="everything on 'left' still ran 15 s"):
        stop(run)


def test_a_stop_says_what_did_not_end_in_time(robot: Robot, agents: FakeAgents) -> None:
    run, journal = run_of(robot, agents)
    run.start()
    before = Fault(container="c", message="was restarted", number=1)
    agents.note_faults(before)
    late = Fault(container="c", message="was ended: it parks", number=2)
    agents.faults = before, late
    stop(run)
    assert run.remaining == (
        "stopped, but: container 'c' on 'left' was ended: it parks; "
        "container 'c' on 'right' was ended: it parks"
    )
    assert journal.entries()[-1].what == "everything stopped"


def test_a_stop_says_what_still_runs_out_of_reach(
    robot: Robot, agents: FakeAgents
) -> None:
    run, journal = run_of(robot, agents)
    run.start()
    agents.gone.add("right")
    agents.refusing.add("right")
    with pytest.raises(
        RunError, match=r"'right' has been out of reach since .* thinker stops"
    ):
        stop(run)
    assert not agents.statuses()["left"].containers
    assert journal.entries()[-1].kind == "failed"


def test_a_stop_reaches_a_computer_that_comes_back_meanwhile(
    robot: Robot, agents: FakeAgents
) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    agents.gone.add("right")
    agents.returns = True
    stop(run)
    assert not agents.statuses()["right"].containers


def test_claims_all_agents_before_it_starts_anything(
    robot: Robot, agents: FakeAgents
) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    assert agents.claimed == ["left", "right"]


def test_a_computer_that_may_be_out_of_reach_is_not_waited_for(
    robot: Robot, agents: FakeAgents
) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    agents.gone.add("right")
    run.goes_on_without_lost = True
    run.raise_on_lost()
    agents.deaf.add("right")
    run.commit(run.desired.aiming("active", run.placed.keys()), "again")
    run.wait([run.placed["grabber"]], 1.0)


def test_a_cancelled_wait_ends(robot: Robot, agents: FakeAgents) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    run.cancel()
    with pytest.raises(RunError, match="the robot is being stopped"):
        run.wait([run.placed["grabber"]], 1.0)
    stop(run)
    assert not agents.statuses()["left"].containers


def test_a_computer_that_came_back_is_told_again(
    robot: Robot, agents: FakeAgents
) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    told = len(agents.deployed)
    agents.strangers.add("right")
    run.reconcile()
    run.reconcile()
    assert [computer for computer, _ in agents.deployed[told:]] == ["right"]
    assert agents.claimed == ["left", "right", "right"]


def test_a_computer_that_has_not_reported_again_keeps_its_address(
    robot: Robot, agents: FakeAgents
) -> None:
    """Else what is told meanwhile breaks the components whose connectors lead there."""
    placement = {"filter": "left", "thinker": "right"}
    journal = Journal(":memory:")
    live = LiveRobot(robot, placement, cast("Agents", agents), journal, "/run")
    live.start()
    agents.forget("right")
    live.commit(live.desired.aiming("inactive", ["filter"]), "it ends")
    (container,) = agents.deployed[-1][1].containers
    assert [c.address for c in container.connectors] == ["right:7000/mind"]


def test_what_is_out_of_reach_has_not_surely_ended(
    robot: Robot, agents: FakeAgents
) -> None:
    """Its agent may not know yet that it should: something else must not start."""
    run, _ = run_of(robot, agents)
    run.start()
    run.goes_on_without_lost = True
    old = run.placed["thinker"]
    agents.gone.add("right")
    run.commit(run.desired.without(["thinker"]), "a test")
    with pytest.raises(RunError, match="computer 'right' has been out of reach"):
        run.wait_ended(old)


def test_what_cannot_be_computed_now_is_told_later(
    robot: Robot, agents: FakeAgents, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, _ = run_of(robot, agents)
    run.clock = run.parts._clock = clock = VirtualClock()
    run.start()
    deployments = run.layout.deployments

    def unreadable(*_: object) -> None:
        raise OSError("a file of the code is being written")

    monkeypatch.setattr(run.layout, "deployments", unreadable)
    run.commit(run.desired.aiming("inactive", ["thinker"]), "a test")
    assert "a file of the code" in run.parts.deviations()[0].what
    monkeypatch.setattr(run.layout, "deployments", deployments)
    clock.sleep(2.0)
    run.reconcile()
    (container,) = agents.deployed[-1][1].containers
    assert container.components[0].goal == "inactive"


def test_only_what_runs_or_comes_may_fail_a_wait(
    robot: Robot, agents: FakeAgents
) -> None:
    """A target that is configured ahead may fail: its own migration says so."""
    run, _ = run_of(robot, agents)
    run.start()
    ahead = structs.replace(run.placed["grabber"], epoch=7, goal="inactive")
    agents.states["grabber"] = ComponentStatus(name="grabber", epoch=7, state="failed")
    run.commit(run.desired.with_configured_ahead([ahead]), "a test")
    run.watch(0.0)


def test_a_stop_ends_what_is_back_though_not_all_is(
    robot: Robot, agents: FakeAgents
) -> None:
    third = structs.replace(robot.computers[0], name="third")
    agents.report(structs.replace(agents.statuses()["left"], computer="third"))
    robot = structs.replace(robot, computers=(*robot.computers, third))
    run, _ = run_of(robot, agents)
    run.start()
    agents.gone |= {"right", "third"}
    agents.back = "right"
    with pytest.raises(RunError, match="computer 'third' has been out of reach"):
        stop(run)
    assert not agents.statuses()["right"].containers


def test_what_no_lease_ends_starts_nowhere_else_while_its_computer_is_lost(
    robot: Robot, agents: FakeAgents
) -> None:
    fixed = [
        structs.replace(
            each,
            components=tuple(
                structs.replace(c, movable=False) for c in each.components
            ),
        )
        for each in robot.architectures
    ]
    run, _ = run_of(structs.replace(robot, architectures=tuple(fixed)), agents)
    run.start()
    run.goes_on_without_lost = True
    new = structs.replace(run.placed["thinker"], computer="left", epoch=9)
    agents.gone.add("right")
    run.commit(run.desired.without(["thinker"]), "a test")
    with pytest.raises(RunError, match="'thinker' may still be at work on 'right'"):
        run.end_left_behind([new])
    assert not agents.revoked


def test_what_was_dropped_as_its_computer_was_lost_has_no_lease_when_it_starts_anew(
    robot: Robot, agents: FakeAgents
) -> None:
    """Another agent may have heard that computer, and so its component was active."""
    run, _ = run_of(robot, agents)
    run.start()
    run.goes_on_without_lost = True
    old = run.placed["thinker"]
    new = structs.replace(old, computer="left", epoch=old.epoch + 1)
    agents.gone.add("right")
    run.commit(run.desired.without(["thinker"]), "a test")
    run.end_left_behind([new])
    assert agents.revoked == ["right"]
    agents.gone.clear()
    run.commit(run.desired.placing([new]), "a test")  # right is told, and obeys
    run.commit(run.desired.without(["thinker"]), "a test")
    agents.gone.add("right")
    run.end_left_behind([structs.replace(new, epoch=new.epoch + 1)])
    assert agents.revoked == ["right"]


def test_epochs_of_a_later_leader_are_above_all_of_those_before(
    robot: Robot, agents: FakeAgents
) -> None:
    agents.election = Election(votes={"left": 1, "right": 1})
    agents.manager = structs.replace(agents.manager, term=3)
    run, _ = run_of(robot, agents)
    assert run.placed["thinker"].epoch == 3 << 16
    assert run.next_epoch("thinker") == (3 << 16) + 1


def test_what_begins_after_a_take_over_has_an_epoch_that_nothing_had(
    robot: Robot, agents: FakeAgents
) -> None:
    """What a computer out of reach runs is not known: its epoch is no higher."""
    for name, generation in (("left", 9), ("right", 4)):
        status = agents.statuses()[name]
        agents.report(structs.replace(status, generation=generation))
    run, _ = run_of(robot, agents)
    run.adopt(Desired(tasks=b"t"), {"grabber": 2})
    assert (run.next_epoch("thinker"), run.next_epoch("grabber")) == (10, 3)
    assert (run.desired.generation, run.desired.tasks) == (10, b"t")


def test_an_agent_that_knows_nothing_gets_the_checkpoints_of_its_own_components(
    robot: Robot, agents: FakeAgents
) -> None:
    """It has booted anew, and removed what was in its folder."""
    run, _ = run_of(robot, agents)
    run.start()
    for name, placed in run.placed.items():
        copy = CheckpointCopy(component=name, epoch=placed.epoch, data=b"x", age=1.0)
        agents.checkpoints.note(copy)
    agents.strangers.add("right")
    for _ in range(3):
        run.reconcile()
    assert [(at, copy.component) for at, copy in agents.kept] == [("right", "thinker")]


def test_what_was_replaced_by_deployed_code_begins_again_with_it(
    robot: Robot, agents: FakeAgents
) -> None:
    run, _ = run_of(robot, agents)
    run.start()
    other = structs.replace(run.placed["thinker"], code="v2")
    run.commit(run.desired.placing([other]), "a test")
    run.commit(run.desired.without(["thinker"]), "a test")
    assert run.begun("thinker", "left").code == "v2"
    run.commit(run.desired.placing([structs.replace(other, code="")]), "a test")
    run.commit(run.desired.without(["thinker"]), "a test")
    assert run.begun("thinker", "left").code == ""
