"""What was sent and neither processed nor refused."""

from __future__ import annotations

from msgspec.structs import replace

from poise.manage.deploy.deactivation import _left, maybe_active
from poise.manage.deploy.desired import Incarnation
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    State,
    Summary,
)


def ends(processed: int, errors: int) -> list[ConnectorStatus]:
    """Return both ends of a connector over which five messages were sent."""
    source = ConnectorStatus(
        name="a.out-b.in", kind="local", end="source", ready=True, messages=5
    )
    target = ConnectorStatus(
        name="a.out-b.in",
        kind="local",
        end="target",
        ready=True,
        messages=5,
        errors=errors,
        wait=Summary(count=processed),
    )
    return [source, target]


def test_a_refused_message_is_not_lost() -> None:
    assert _left(ends(processed=3, errors=2), (), keeps=False) == 0


def test_what_was_not_processed_is_left() -> None:
    assert _left(ends(processed=3, errors=0), (), keeps=False) == 2


def test_what_was_dropped_where_it_was_sent_hides_nothing_that_was_sent() -> None:
    source, target = ends(processed=3, errors=0)
    source = replace(source, drops=9)  # there was no room for nine more
    assert _left([source, target], (), keeps=False) == 2
    both = replace(source, end="both", wait=Summary(count=3))
    assert _left([both], (), keeps=False) == 2


def test_what_made_room_for_newer_messages_is_not_lost() -> None:
    source, target = ends(processed=3, errors=0)
    assert _left([source, replace(target, drops=2)], (), keeps=True) == 0
    both = replace(target, end="both", drops=1)
    assert _left([both], (), keeps=True) == 1


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
