"""What is gone from the statuses stays in the report."""

from __future__ import annotations

from collections.abc import Sequence

from poise.manage.agent_connections.statuses import Statuses, connectors_of, located
from poise.session.reports.last_seen import LastSeen
from poise.wire.records.status import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
)


def on(
    computer: str, *components: str, ends: Sequence[tuple[str, int]] = (), pid: int = 1
) -> dict[str, AgentStatus]:
    container = ContainerStatus(
        name="arm",
        pid=pid,
        components=tuple(ComponentStatus(name=n, state="active") for n in components),
        connectors=tuple(
            ConnectorStatus(name=n, kind="local", end="source", ready=True, messages=m)
            for n, m in ends
        ),
    )
    return {computer: agent(computer, container)}


def agent(computer: str, *containers: ContainerStatus) -> AgentStatus:
    return AgentStatus(
        computer=computer, generation=1, cpu=0.0, uptime=1.0, containers=containers
    )


def where(statuses: Statuses) -> list[tuple[str, str]]:
    return [(computer, component.name) for computer, component in located(statuses)]


def test_keeps_components_and_connectors_that_are_gone() -> None:
    seen = LastSeen()
    seen.look(on("left", "hand", "eye", ends=[("eye.x-hand.x", 3)]))
    seen.look(on("left", "hand", "eye", ends=[("eye.x-hand.x", 7)]))
    merged = seen.merged(on("left", "hand"))
    assert where(merged) == [("left", "hand"), ("left", "eye")]
    assert [end.messages for end in connectors_of(merged)] == [7]


def test_keeps_a_container_that_is_gone() -> None:
    seen = LastSeen()
    seen.look(on("left", "hand"))
    merged = seen.merged({"left": agent("left")})
    assert where(merged) == [("left", "hand")]


def test_counts_what_moved_only_where_it_was_last() -> None:
    seen = LastSeen()
    ends = [("eye.x-hand.x", 3)]
    seen.look(on("left", "eye", ends=ends) | on("right"))
    seen.look(on("left") | on("right", "eye", ends=ends))
    merged = seen.merged(on("left") | on("right"))
    assert where(merged) == [("right", "eye")]
    assert len(list(connectors_of(merged))) == 1


def test_keeps_what_a_container_had_counted_when_another_took_its_place() -> None:
    seen = LastSeen()
    seen.look(on("left", "eye", ends=[("eye.x-hand.x", 3)]))
    seen.look(on("left"))
    seen.look(on("left", "eye", ends=[("eye.x-hand.x", 1)], pid=2))
    assert [end.messages for end in seen.ended] == [3]


def test_what_comes_back_from_elsewhere_has_its_count_with_it() -> None:
    seen = LastSeen()
    seen.look(on("left", "eye", ends=[("eye.x-hand.x", 3)]))
    seen.look(on("left") | on("right", "eye", ends=[("eye.x-hand.x", 4)]))
    seen.look(on("left", "eye", ends=[("eye.x-hand.x", 5)], pid=2) | on("right"))
    assert not seen.ended
