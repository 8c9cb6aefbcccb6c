"""What is waited for until it is inactive."""

from __future__ import annotations

from collections.abc import Callable
from unittest.mock import Mock

import pytest

from poise.manage.deploy.deactivation import drain, maybe_active
from poise.manage.deploy.desired import Incarnation
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerStatus,
    State,
)

PLACES = [Incarnation(component="eye", computer="left")]


def said(state: State) -> dict[str, AgentStatus]:
    """Return what the agent of `left` says of its only component."""
    eye = ComponentStatus(name="eye", epoch=0, state=state)
    container = ContainerStatus(name="all", pid=1, components=(eye,))
    agent = AgentStatus(
        computer="left", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    return {"left": agent}


def test_a_component_may_be_active_until_its_agent_says_otherwise() -> None:
    assert maybe_active(PLACES, {"left"}, {}) == ["eye"]
    assert maybe_active(PLACES, {"left"}, said("active")) == ["eye"]
    assert maybe_active(PLACES, {"left"}, said("inactive")) == []


def test_a_component_out_of_reach_is_not_waited_for() -> None:
    assert maybe_active(PLACES, {"right"}, {}) == []


@pytest.mark.parametrize(("state", "is_there"), [("active", False), ("inactive", True)])
def test_what_came_to_rest_as_its_action_ended_says_its_final_counts(
    state: State,
    is_there: bool,  # noqa: FBT001, a parameter of a test
) -> None:
    live, waited = Mock(placed={}), list[bool]()

    def wait(holds: Callable[[], bool], _limit: float) -> bool:
        waited.append(holds())
        return waited[-1]

    live.desired.prefetched = {"eye": PLACES[0]}
    live.agents.wait_news = wait
    live.layout.connectors.return_value = []
    live.computers.return_value = {"left"}
    live.current.return_value = said(state)
    drain(live, lambda _: {})
    assert waited == [is_there]
