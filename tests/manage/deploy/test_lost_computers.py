"""Agents that were restarted are told of, also when nobody saw them end."""

from __future__ import annotations

from typing import cast

import pytest
from msgspec import structs

from poise.errors import RunError
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.lost_computers import LostComputers
from poise.manage.journal import Journal
from poise.model.robot import Robot
from poise.wire.records.request_records import CheckpointCopy
from poise.wire.records.status_records import ComponentStatus
from tests.manage.conftest import FakeAgents

PLACEMENT = {"grabber": "left", "thinker": "right"}
LOST = (
    "component 'thinker' began again on 'right' without the state that it had: its "
    "process had ended with the agent or the computer; it has no `checkpoint` in the "
    "robot file"
)


def test_an_agent_that_was_back_before_anybody_looked_is_told_of(robot: Robot) -> None:
    agents, journal = FakeAgents("left", "right"), Journal(":memory:")
    live = LiveRobot(robot, PLACEMENT, cast("Agents", agents), journal, "/run")
    live.start()
    lost = LostComputers(live)
    before, told = len(journal.entries()), len(agents.deployed)
    lost.note()
    assert len(journal.entries()) == before
    status = agents.statuses()["right"]
    agents.report(structs.replace(status, key="next", took_over=("mind",)))
    live.reconcile()
    for _ in range(2):
        lost.note()
    assert [computer for computer, _ in agents.deployed[told:]] == ["right"]
    assert [entry.what for entry in journal.entries()[before:]] == [
        "computer 'right' was cut off, or its agent was restarted",
        "the agent of 'right' was restarted; 1 container went on",
    ]


def test_an_agent_of_which_nothing_is_known_yet_is_told_of(robot: Robot) -> None:
    """It came back before anybody looked, and has not reported since."""
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    lost = LostComputers(live)
    assert lost.deviations() == []
    agents.forget_status("right")
    (told,) = lost.deviations()
    assert told.computer == "right"
    assert "is back, but not yet managed" in told.what


def started(robot: Robot, agents: FakeAgents) -> LiveRobot:
    live = LiveRobot(
        robot, PLACEMENT, cast("Agents", agents), Journal(":memory:"), "/run"
    )
    live.start()
    return live


def stateful(live: LiveRobot) -> ComponentStatus:
    thinker = live.placed["thinker"]
    return ComponentStatus(
        name="thinker", epoch=thinker.epoch, state="active", has_state=True
    )


@pytest.mark.parametrize(
    ("took_over", "told"),
    [((), [LOST]), (("mind",), []), pytest.param(None, [], id="an older agent")],
)
def test_a_state_that_ended_with_its_computer_is_told_of(
    robot: Robot, took_over: tuple[str, ...] | None, told: list[str]
) -> None:
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    lost = LostComputers(live)
    agents.states["thinker"] = stateful(live)
    status = agents.statuses()["right"]
    agents.report(structs.replace(status, pid=8, took_over=took_over, generation=0))
    live.reconcile()
    for _ in range(3):
        lost.note()
    assert [each.what for each in live.lost_states.values()] == told
    assert [
        e.what for e in live.journal.entries() if "without the state" in e.what
    ] == told


def test_a_cut_ends_no_state(robot: Robot) -> None:
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    lost = LostComputers(live)
    agents.states["thinker"] = stateful(live)
    agents.report(structs.replace(agents.statuses()["right"], took_over=()))
    agents.report_component("right", stateful(live))
    agents.gone.add("right")
    lost.note()
    assert lost.away() == {"right"}
    agents.gone.clear()
    for _ in range(3):
        live.reconcile()
        lost.note()
    assert not lost.away()
    assert live.lost_states == {}


@pytest.mark.parametrize(
    ("placement", "more"),
    [
        (PLACEMENT, "; its components keep running"),
        (dict.fromkeys(PLACEMENT, "left"), ""),
    ],
)
def test_of_a_computer_that_is_reached_at_last_only_what_is_there_goes_on(
    robot: Robot, placement: dict[str, str], more: str
) -> None:
    """Of what was replaced meanwhile, the old copies end."""
    agents, journal = FakeAgents("left", "right"), Journal(":memory:")
    live = LiveRobot(robot, placement, cast("Agents", agents), journal, "/run")
    live.start()
    status = agents.statuses()["right"]
    agents.forget_status("right")
    agents.gone.add("right")
    lost = LostComputers(live)
    lost.note()
    agents.gone.clear()
    agents.report(status)
    for _ in range(3):
        live.reconcile()
        lost.note()
    assert journal.entries()[-1].what == f"computer 'right' is reached{more}"


def lose_folder(live: LiveRobot, agents: FakeAgents) -> LostComputers:
    """Let the agent of ``right`` come back, with nothing in its folder."""
    lost = LostComputers(live)
    thinker = live.placed["thinker"]
    copy = CheckpointCopy(component="thinker", epoch=thinker.epoch, data=b"7", age=1.0)
    agents.checkpoints.note(copy)
    agents.states["thinker"] = stateful(live)
    status = agents.statuses()["right"]
    agents.report(structs.replace(status, pid=8, generation=0, containers=()))
    agents.strangers.add("right")
    agents.deployed.clear()
    for _ in range(4):
        live.reconcile()
        lost.note()
    assert [computer for computer, _ in agents.deployed] == ["right"]
    return lost


def test_an_agent_that_has_lost_its_folder_gets_the_checkpoints_again(
    robot: Robot,
) -> None:
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    lose_folder(live, agents)
    assert [(at, copy.component, copy.data) for at, copy in agents.kept] == [
        ("right", "thinker", b"7")
    ]
    told = [entry.what for entry in live.journal.entries()]
    assert any("'thinker' goes on from its state of 1." in what for what in told)
    assert live.lost_states == {}


def test_an_agent_that_knows_what_ran_has_the_newest_checkpoint(robot: Robot) -> None:
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    agents.left_with = {"right": dict(agents.deployed)["right"]}
    lose_folder(live, agents)
    assert agents.kept == []


def test_a_checkpoint_that_an_agent_does_not_take_is_told_of(robot: Robot) -> None:
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    agents.full = {"right"}
    lose_folder(live, agents)
    (told,) = live.lost_states.values()
    assert told.what == (
        "component 'thinker' starts on 'right' without the state that it had: its "
        "agent did not take the checkpoint (no space)"
    )


def test_a_computer_that_still_sends_heartbeats_goes_on(robot: Robot) -> None:
    """Its lease lasts: nothing is started elsewhere, and no room is made for that."""
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    lost = LostComputers(live)
    agents.gone.add("right")
    lost.note()
    assert lost.computers() == {"right"}
    agents.heard.add("right")
    assert lost.computers() == set()
    (told,) = lost.deviations()
    assert told.what.endswith(
        "it still sends heartbeats (UDP), but accepts no connection (TCP): thinker "
        "keeps running"
    )
    agents.lasting_leases.add("right")
    with pytest.raises(RunError, match="heartbeats still come from 'right'"):
        live.revoke_leases({"right"})


def test_a_computer_where_nothing_runs_is_told_to_accept_no_connection(
    robot: Robot,
) -> None:
    agents = FakeAgents("left", "right", "spare")
    live = started(robot, agents)
    agents.gone.add("spare")
    agents.heard.add("spare")
    assert live.unreached()["spare"].endswith(
        "; it still sends heartbeats (UDP), but accepts no connection (TCP)"
    )


def test_the_agent_of_another_computer_at_its_address_is_told_of(robot: Robot) -> None:
    """Somebody has started the agent anew, with another name."""
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    agents.gone |= {"left", "right"}
    agents.others["right"] = "there is the agent of computer 'rite'"
    assert live.unreached()["right"].endswith("; there is the agent of computer 'rite'")
    assert "there is" not in live.unreached()["left"]


def test_reports_that_come_without_heartbeats_are_said(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A firewall drops UDP at the agent's port, and lets TCP through."""
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    agents.gone.add("right")
    what = "its reports (TCP) come, but no heartbeats (UDP)"
    assert what in live.unreached()["right"]
    monkeypatch.setattr(agents, "ages", lambda: {"right": 2.0})
    assert what not in live.unreached()["right"]


def test_a_cause_that_is_known_later_is_journalled_once(robot: Robot) -> None:
    agents = FakeAgents("left", "right")
    live = started(robot, agents)
    lost = LostComputers(live)
    agents.gone.add("right")
    lost.note()
    agents.others["right"] = "there is the agent of computer 'space'"
    for _ in range(3):
        lost.note()
    first, second = [e.what for e in live.journal.entries() if e.kind == "wrong"]
    assert second == f"{first}; {agents.others['right']}"
    agents.others.clear()
    agents.gone.clear()
    live.reconcile()
    lost.note()
    assert len([e for e in live.journal.entries() if e.kind == "wrong"]) == 2
