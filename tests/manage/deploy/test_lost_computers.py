"""Agents that were restarted are told of, also when nobody saw them end."""

from __future__ import annotations

from typing import cast

from msgspec import structs

from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.lost_computers import LostComputers
from poise.manage.journal import Journal
from poise.model.robot import Robot
from tests.manage.conftest import FakeAgents


def test_an_agent_that_was_back_before_anybody_looked_is_told_of(robot: Robot) -> None:
    agents, journal = FakeAgents("left", "right"), Journal(":memory:")
    placement = {"grabber": "left", "thinker": "right"}
    live = LiveRobot(robot, placement, cast("Agents", agents), journal, "/run")
    live.start()
    lost = LostComputers(live)
    before, told = len(journal.entries()), len(agents.deployed)
    lost.note()
    assert len(journal.entries()) == before
    status = agents.statuses()["right"]
    agents.report(structs.replace(status, pid=8, adopted=1))
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
    placement = {"grabber": "left", "thinker": "right"}
    live = LiveRobot(
        robot, placement, cast("Agents", agents), Journal(":memory:"), "/run"
    )
    live.start()
    lost = LostComputers(live)
    assert lost.deviations() == []
    agents.forget_status("right")
    (told,) = lost.deviations()
    assert told.computer == "right"
    assert "is back, but not yet managed" in told.what
