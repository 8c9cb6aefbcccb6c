"""Steps of a transition that fail leave all as it was, and those before are undone."""

from __future__ import annotations

from typing import cast

import pytest
from msgspec import structs

from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration.migration_report import TransitionStep
from poise.manage.migration.transition_run import transit
from poise.model.robot import Robot
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.status_records import ComponentStatus
from tests.manage.conftest import FakeAgents

PLACEMENT = {"grabber": "left", "filter": "left"}
START = TransitionStep("thinker", target="right")
STOP = TransitionStep("filter", "left")


@pytest.fixture
def agents() -> FakeAgents:
    return FakeAgents("left", "right")


@pytest.fixture
def live(robot: Robot, agents: FakeAgents) -> LiveRobot:
    live = LiveRobot(
        robot, PLACEMENT, cast("Agents", agents), Journal(":memory:"), "/run"
    )
    live.start()
    return live


def told(agents: FakeAgents) -> dict[str, tuple[str, int, str]]:
    """Return what each agent was told last: component -> computer, epoch and class."""
    last: dict[str, Deployment] = dict(agents.deployed)
    return {
        component.name: (computer, component.epoch, component.implementation)
        for computer, deployment in last.items()
        for container in deployment.containers
        for component in container.components
    }


def test_what_cannot_be_started_is_placed_nowhere(
    live: LiveRobot, agents: FakeAgents
) -> None:
    agents.states["thinker"] = ComponentStatus(
        name="thinker", state="failed", error="ValueError: no thought"
    )
    report = transit(live, (START,))
    assert not report.committed
    assert "ValueError: no thought" in report.reason
    assert live.placement() == PLACEMENT
    assert told(agents).keys() == PLACEMENT.keys()


def test_what_does_not_end_is_started_anew(live: LiveRobot, agents: FakeAgents) -> None:
    agents.deaf = {"left"}
    report = transit(live, (STOP,))
    assert not report.committed
    assert "component 'filter' still runs on 'left' 15 s after" in report.reason
    assert live.placement() == PLACEMENT
    assert told(agents)["filter"] == ("left", 1, "eye:Filter")


def test_what_was_replaced_stays_replaced_over_a_cold_move(
    live: LiveRobot, agents: FakeAgents
) -> None:
    better = structs.replace(live.placed["filter"], implementation="eye:Better")
    live.commit(live.desired.placing([better]), "it was replaced")
    again = TransitionStep("filter", target="right")
    assert transit(live, (STOP, again)).committed
    assert told(agents)["filter"] == ("right", 1, "eye:Better")


def test_a_move_that_is_refused_undoes_the_steps_before(
    live: LiveRobot, agents: FakeAgents
) -> None:
    nowhere = TransitionStep("grabber", "left", "moon")
    report = transit(live, (START, nowhere))
    assert not report.committed
    assert "no computer 'moon'" in report.reason
    assert live.placement() == PLACEMENT
    assert told(agents).keys() == PLACEMENT.keys()
