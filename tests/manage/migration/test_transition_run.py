"""Steps of a transition that fail leave all as it was, and those before are undone."""

from __future__ import annotations

from collections.abc import Collection
from typing import cast

import pytest
from msgspec import structs

from poise.errors import RunError, UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import ACTIVE_LIMIT, LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration.migration_report import TransitionStep
from poise.manage.migration.move import check_target
from poise.manage.migration.transition_run import start_together, transit
from poise.model.robot import Computer, Robot
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.request_records import Election
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


def test_where_a_component_may_run_is_said_in_order(
    robot: Robot, agents: FakeAgents
) -> None:
    more = [Computer(name=name, capacity={"cpu": 1.0}) for name in "hgfedcba"]
    robot = structs.replace(
        robot.with_components(lambda c: structs.replace(c, only=tuple("hgfedcba"))),
        computers=(*robot.computers, *more),
    )
    journal, where = Journal(":memory:"), {"filter": "a"}
    live = LiveRobot(robot, where, cast("Agents", agents), journal, "/run")
    with pytest.raises(UsageError, match="only on a or b or c or d or e or f or g or"):
        check_target(live, "filter", "left", force=True)


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


def test_undoing_a_step_may_fail_and_is_named_then(
    live: LiveRobot, agents: FakeAgents
) -> None:
    agents.states["filter"] = ComponentStatus(
        name="filter", epoch=1, state="failed", error="no clean water"
    )
    report = transit(live, (STOP, TransitionStep("grabber", "left", "moon")))
    assert not report.committed
    assert "no computer 'moon'" in report.reason
    assert f"; rolling back '{STOP}' failed: component 'filter'" in report.reason
    assert "no clean water" in report.reason


def test_what_starts_where_it_was_not_has_no_lease_where_it_may_be_at_work(
    live: LiveRobot, agents: FakeAgents
) -> None:
    live.goes_on_without_lost = True
    assert transit(live, (START,)).committed
    agents.gone.add("right")
    live.commit(live.desired.without(["thinker"]), "a test")
    assert transit(live, (TransitionStep("thinker", target="left"),)).committed
    assert agents.revoked == ["right"]


def is_told_active(agents: FakeAgents, name: str, computer: str) -> bool:
    return any(
        each.name == name and each.goal == "active"
        for at, deployment in agents.deployed
        if at == computer
        for container in deployment.containers
        for each in container.components
    )


def test_what_starts_together_does_so_once_it_has_ended_where_it_was(
    live: LiveRobot, agents: FakeAgents
) -> None:
    agents.deaf.add("left")
    assert not start_together(live, {"filter": "right"})
    assert not is_told_active(agents, "filter", "right")
    assert live.placement() == PLACEMENT
    assert not live.desired.coming
    agents.deaf.clear()
    assert start_together(live, {"filter": "right"})
    assert is_told_active(agents, "filter", "right")
    assert live.placement() == {**PLACEMENT, "filter": "right"}


def test_what_is_lost_starts_elsewhere_once_its_lease_has_ended(
    live: LiveRobot, agents: FakeAgents
) -> None:
    live.goes_on_without_lost = True
    agents.gone.add("left")
    agents.heard.add("left")
    agents.lasting_leases.add("left")
    assert not start_together(live, {"filter": "right"}, lost=["left"])
    assert not is_told_active(agents, "filter", "right")
    assert live.placement() == PLACEMENT
    agents.lasting_leases.clear()
    assert start_together(live, {"filter": "right"}, lost=["left"])
    assert agents.revoked == ["left"]


@pytest.mark.parametrize("is_stored", [True, False])
def test_where_managers_are_voted_for_a_majority_must_know_before_it_is_active(
    live: LiveRobot,
    agents: FakeAgents,
    monkeypatch: pytest.MonkeyPatch,
    *,
    is_stored: bool,
) -> None:
    def has_stored(_: int) -> bool:
        assert live.placement()["thinker"] == "right"
        assert not is_told_active(agents, "thinker", "right")
        return is_stored

    agents.election = Election(votes={"left": 1, "right": 1})
    monkeypatch.setattr(agents, "has_stored", has_stored)
    assert start_together(live, {"thinker": "right"}) == is_stored
    assert is_told_active(agents, "thinker", "right") == is_stored
    assert ("thinker" in live.placement()) == is_stored


def test_what_cannot_be_activated_stays_only_where_it_was_lost_before(
    live: LiveRobot, agents: FakeAgents, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Then it runs nowhere else, and is tried on."""
    wait = live.wait

    def fail(wanted: Collection[Incarnation], limit: float) -> None:
        if limit == ACTIVE_LIMIT:
            raise RunError("no motor")
        wait(wanted, limit)

    live.goes_on_without_lost = True
    monkeypatch.setattr(live, "wait", fail)
    assert not start_together(live, {"thinker": "right"})
    assert live.placement() == PLACEMENT
    agents.gone.add("left")
    assert not start_together(live, {"filter": "right"}, lost=["left"])
    assert live.placement() == {**PLACEMENT, "filter": "right"}


def test_who_had_a_state_where_it_ran_loses_it_without_a_checkpoint(
    live: LiveRobot, agents: FakeAgents
) -> None:
    known = ComponentStatus(name="filter", epoch=0, state="active", has_state=True)
    agents.report_component("left", known)
    assert start_together(live, {"grabber": "left"})
    assert live.lost_states == {}
    agents.report_component("left", known)
    assert start_together(live, {"filter": "right"})
    (lost,) = live.lost_states.values()
    why = "it has no `checkpoint` in the robot file"
    had = "without the state that it had on 'left'"
    assert lost.what == f"component 'filter' started {had}: {why}"
