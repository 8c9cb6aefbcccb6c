"""What is said of a running robot, and of what is being moved."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import pytest
from msgspec.structs import replace

from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.observe import watch
from poise.manage.observe.watch import Watch
from poise.model.robot import Robot
from poise.wire.records.status_records import (
    ComponentStatus,
    ConnectorStatus,
    ContainerHealth,
    ContainerStatus,
    Fault,
)
from tests.manage.conftest import FakeAgents

if TYPE_CHECKING:
    from poise.manage.agent_connections.agents import Agents

RAW = ConnectorStatus(
    name="grabber.raw-filter.raw", kind="local", end="source", ready=False
)


def unjoined(
    robot: Robot, agents: FakeAgents, journal: Journal, *components: str
) -> tuple[LiveRobot, Watch]:
    """Return a robot with components on 'left', of which `RAW` is not joined."""
    placement = dict.fromkeys(components, "left")
    live = LiveRobot(robot, placement, cast("Agents", agents), journal, "/run")
    live.start()
    seen = Watch(live)
    agents.unjoined = (RAW,)
    agents.report(replace(agents.statuses()["left"], pid=9))  # so it is told again
    live.reconcile()
    return live, seen


def test_a_connector_is_not_said_to_be_joined_because_its_end_is_moved(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watch, "_LASTS", 0.0)
    agents, journal = FakeAgents("left", "right"), Journal(":memory:")
    live, seen = unjoined(robot, agents, journal, "grabber", "filter")
    seen.record()
    what = f"connector '{RAW.name}' from 'left' does not reach 'left'"
    assert [each.what for each in seen.deviations] == [what]
    live.commit(live.desired.aiming("stay", ["filter"]), "it is to move")
    seen.record()
    assert [each.what for each in seen.deviations] == [what]
    agents.unjoined = ()
    live.commit(live.desired.aiming("active", ["filter"]), "it stays")
    seen.record()
    assert not seen.deviations
    said = [(e.kind, e.what) for e in journal.entries() if "reach" in e.what]
    assert said == [("wrong", what), ("right", f"no more: {what}")]


def test_what_crashes_before_it_is_configured_is_not_said_to_be_healthy(
    robot: Robot,
) -> None:
    agents, journal = FakeAgents("left", "right"), Journal(":memory:")
    live = LiveRobot(robot, {}, cast("Agents", agents), journal, "/run")
    live.start()
    seen = Watch(live)
    agents.states["thinker"] = ComponentStatus(
        name="thinker", epoch=1, state="unconfigured"
    )
    thinker = Incarnation(component="thinker", computer="left", epoch=1)
    live.commit(live.desired.with_coming([thinker]), "it starts")
    health = ContainerHealth(name="mind", state="running", since=0.0)
    fault = Fault(container="mind", message="was killed by SIGSEGV", number=1)
    left = replace(agents.statuses()["left"], health=(health,), faults=(fault,))
    agents.report(left)
    seen.record()
    said = ["container 'mind' on 'left' was killed by SIGSEGV"]
    assert [e.what for e in journal.entries() if "'mind'" in e.what] == said
    component = ComponentStatus(name="thinker", epoch=1, state="inactive")
    agents.report_component("left", component)
    seen.record()
    said.append("container 'mind' on 'left' is healthy again")
    assert [e.what for e in journal.entries() if "'mind'" in e.what] == said


def test_what_is_wrong_stays_so_until_its_agent_has_heard_what_is_new(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command let it be right for a moment, and a connector for two seconds."""
    monkeypatch.setattr(watch, "_LASTS", 0.0)
    agents, journal = FakeAgents("left", "right"), Journal(":memory:")
    _, seen = unjoined(robot, agents, journal, "grabber", "filter", "thinker")
    failed = ComponentStatus(name="thinker", state="failed")
    agents.report_component("left", failed)
    agents.report(replace(agents.statuses()["left"], trouble="the disk is full"))
    before = len(journal.entries())
    seen.record()
    told = {each.what for each in seen.deviations}
    assert len(told) == 3
    late = agents.statuses()["left"]
    agents.report(replace(late, generation=0, trouble="", containers=()))
    seen.record()
    assert {each.what for each in seen.deviations} == told
    agents.report(replace(late, trouble=""))
    seen.record()
    assert len(seen.deviations) == 2
    kinds = [entry.kind for entry in journal.entries()[before:]]
    assert kinds == ["wrong"] * 3 + ["right"]


def test_a_container_that_is_ending_is_not_said_to_run_but_should_not(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a move leaves behind takes a moment to end, and is looked at meanwhile."""
    agents, journal = FakeAgents("left", "right"), Journal(":memory:")
    live = LiveRobot(robot, {}, cast("Agents", agents), journal, "/run")
    live.start()
    seen, before = Watch(live), len(journal.entries())
    odd = ContainerStatus(name="odd", pid=7, components=())
    agents.report(replace(agents.statuses()["left"], containers=(odd,)))
    seen.record()
    assert not seen.deviations
    assert len(journal.entries()) == before
    monkeypatch.setattr(watch, "_LASTS", 0.0)
    seen.record()
    (found,) = seen.deviations
    assert found.what == "container 'odd' runs on 'left' but should not"
