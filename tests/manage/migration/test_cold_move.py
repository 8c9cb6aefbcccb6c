"""Moves of what has no state to be transferred, as agents are told of them."""

from __future__ import annotations

from typing import cast

import pytest

from poise.errors import UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration.move import plan_move, plan_replacement
from poise.model.robot import Robot
from poise.wire.records.request_records import CheckpointCopy
from poise.wire.records.status_records import ComponentStatus
from tests.manage.conftest import FakeAgents


@pytest.fixture
def agents() -> FakeAgents:
    return FakeAgents("left", "right")


@pytest.fixture
def live(robot: Robot, agents: FakeAgents) -> LiveRobot:
    placement = {"driver": "left", "thinker": "left"}
    live = LiveRobot(
        robot, placement, cast("Agents", agents), Journal(":memory:"), "/run"
    )
    live.start()
    agents.deployed.clear()
    return live


def told(agents: FakeAgents, component: str) -> list[tuple[str, str]]:
    """Return the computers and goals of a component, as agents were told them."""
    found = [
        (computer, each.goal)
        for computer, deployment in agents.deployed
        for container in deployment.containers
        for each in container.components
        if each.name == component
    ]
    return list(dict.fromkeys(found))


def test_a_command_is_prepared_elsewhere_and_starts_there_once_it_has_ended(
    live: LiveRobot, agents: FakeAgents
) -> None:
    report = plan_move(live, "driver", "right").run()
    assert (report.committed, report.cold, report.reason) == (True, True, "")
    assert told(agents, "driver") == [("right", "inactive"), ("right", "active")]
    assert live.placement()["driver"] == "right"


def test_a_command_that_does_not_end_starts_nowhere_else(
    live: LiveRobot, agents: FakeAgents
) -> None:
    agents.deaf.add("left")
    report = plan_move(live, "driver", "right").run()
    assert not report.committed
    assert "component 'driver' still runs on 'left' 15 s after" in report.reason
    assert ("right", "active") not in told(agents, "driver")
    assert live.placement()["driver"] == "left"
    assert not live.desired.coming


def test_a_command_goes_on_where_it_cannot_be_prepared_elsewhere(
    live: LiveRobot, agents: FakeAgents
) -> None:
    old = live.placed["driver"]
    agents.states["driver"] = ComponentStatus(
        name="driver", epoch=old.epoch + 1, state="failed", error="no such file"
    )
    report = plan_move(live, "driver", "right").run()
    assert not report.committed
    assert "no such file" in report.reason
    assert live.placed["driver"] == old
    assert not live.desired.coming
    assert not agents.statuses()["right"].containers


FAILED_BEFORE = ComponentStatus(name="thinker", epoch=0, state="failed")


def has_failed(live: LiveRobot, agents: FakeAgents) -> None:
    """Let the thinker have failed, and another component not."""
    failed = ComponentStatus(
        name="thinker", epoch=live.placed["thinker"].epoch, state="failed", error="E"
    )
    agents.report_component("left", failed)


def test_what_has_failed_goes_on_elsewhere_from_its_checkpoint(
    live: LiveRobot, agents: FakeAgents
) -> None:
    has_failed(live, agents)
    old = live.placed["thinker"]
    copy = CheckpointCopy(component="thinker", epoch=old.epoch, data=b"x", age=1.0)
    agents.checkpoints.note(copy)
    report = plan_move(live, "thinker", "right").run()
    assert (report.committed, report.cold) == (True, True)
    new = live.placed["thinker"]
    assert (new.computer, new.fresh) == ("right", False)
    ((where, kept),) = agents.kept
    assert (where, kept.epoch, kept.data) == ("right", new.epoch, b"x")


def test_what_has_failed_begins_fresh_without_a_checkpoint_or_where_it_is_told_to(
    live: LiveRobot, agents: FakeAgents
) -> None:
    has_failed(live, agents)
    assert plan_replacement(live, "thinker", "mind:Better").run().committed
    assert live.placed["thinker"].fresh
    has_failed(live, agents)
    epoch = live.placed["thinker"].epoch
    copy = CheckpointCopy(component="thinker", epoch=epoch, data=b"x", age=1.0)
    agents.checkpoints.note(copy)
    assert plan_replacement(live, "thinker", "mind:Best", fresh=True).run().committed
    assert live.placed["thinker"].fresh
    assert not agents.kept


def test_the_state_of_what_has_failed_is_not_adapted(
    live: LiveRobot, agents: FakeAgents
) -> None:
    has_failed(live, agents)
    with pytest.raises(UsageError, match="'thinker' has failed, and --adapt maps"):
        plan_replacement(live, "thinker", "mind:Better", "mind:adapt")
    live.commit(live.desired.without(["thinker"]), "a test")
    again = live.begun("thinker", "left")
    live.commit(live.desired.placing([again]), "it works again")
    agents.report_component("left", FAILED_BEFORE)
    plan_replacement(live, "thinker", "mind:Better", "mind:adapt")  # is not refused
