"""What is gone from the statuses stays in the report."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec.structs import replace

from poise.manage.agent_connections.statuses import Statuses, connectors_of, located
from poise.session.last_seen import LastSeen
from poise.wire.records.status_records import (
    AgentStatus,
    ChainStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    ErrorCount,
    Summary,
    TimerStatus,
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
    seen.record(on("left", "hand", "eye", ends=[("eye.x-hand.x", 3)]))
    seen.record(on("left", "hand", "eye", ends=[("eye.x-hand.x", 7)]))
    merged = seen.merged(on("left", "hand"))
    assert where(merged) == [("left", "hand"), ("left", "eye")]
    assert [end.messages for end in connectors_of(merged)] == [7]


def test_keeps_a_container_that_is_gone() -> None:
    seen = LastSeen()
    seen.record(on("left", "hand"))
    merged = seen.merged({"left": agent("left")})
    assert where(merged) == [("left", "hand")]


def test_counts_what_moved_only_where_it_was_last() -> None:
    seen = LastSeen()
    ends = [("eye.x-hand.x", 3)]
    seen.record(on("left", "eye", ends=ends) | on("right"))
    seen.record(on("left") | on("right", "eye", ends=ends))
    merged = seen.merged(on("left") | on("right"))
    assert where(merged) == [("right", "eye")]
    assert len(list(connectors_of(merged))) == 1


def test_keeps_what_a_container_had_counted_when_another_took_its_place() -> None:
    seen = LastSeen()
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 3)]))
    seen.record(on("left"))
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 1)], pid=2))
    assert [end.messages for end in seen.ended] == [3]


def test_a_connector_counts_what_all_processes_at_its_end_did() -> None:
    """Of a source that began again after an action, the target counts all."""
    seen = LastSeen()
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 30)]))
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 4)], pid=2))
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 20)], pid=2))
    seen.record(on("left"))
    assert [end.messages for end in seen.connectors()] == [50]


def test_what_a_process_counted_counts_once_however_many_follow() -> None:
    seen = LastSeen()
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 30)]))
    for pid in (2, 3):  # not connected yet
        seen.record(on("left", "eye", pid=pid))
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 1)], pid=3))
    assert [end.messages for end in seen.ended] == [30]
    assert [end.messages for end in seen.connectors()] == [31]
    (end,) = connectors_of(seen.merged(on("left", "eye", pid=3)))
    assert end.messages == 31


def test_an_end_that_is_joined_again_in_its_process_counts_on() -> None:
    seen = LastSeen()
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 30)]))
    seen.record(on("left", "eye"))
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 20)]))
    assert [end.messages for end in seen.connectors()] == [50]


def test_what_comes_back_from_elsewhere_has_its_count_with_it() -> None:
    seen = LastSeen()
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 3)]))
    seen.record(on("left") | on("right", "eye", ends=[("eye.x-hand.x", 4)]))
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 5)], pid=2) | on("right"))
    assert not seen.ended


def counted(
    epoch: int, releases: int, missed: int, errors: tuple[ErrorCount, ...] = ()
) -> ComponentStatus:
    ran = Summary(count=releases, mean=float(epoch), maximum=epoch)
    timer = TimerStatus(
        name="tick",
        period=0.1,
        deadline=0.1,
        releases=releases,
        missed=missed,
        lateness=ran,
        duration=ran,
    )
    return ComponentStatus(
        name="hand",
        state="active",
        epoch=epoch,
        cpu=float(releases),
        errors=len(errors),
        error_counts=errors,
        timers=(timer,),
        chains=(ChainStatus(name="c", deadline=1.0, missed=missed, age=ran),),
        measures={"grip": ran},
    )


def running(computer: str, *components: ComponentStatus, pid: int = 1) -> AgentStatus:
    container = ContainerStatus(name="arm", pid=pid, components=components)
    return agent(computer, container)


def test_adds_up_what_was_counted_in_each_place() -> None:
    """A report of a run with a move would else be silent on what was before."""
    seen = LastSeen()
    error = ErrorCount(where="tick", text="oops", first=3.0, count=1)
    left, right = running("left"), running("right")
    seen.record({"left": running("left", counted(1, 5, 4)), "right": right})
    first = counted(1, 10, 9, errors=(error,))
    prepared = running("right", counted(2, 0, 0))
    seen.record({"left": running("left", first), "right": prepared})
    seen.record({"left": left, "right": running("right", counted(2, 20, 0, (error,)))})
    again = running("right", counted(2, 10, 1), pid=2)
    ((computer, found),) = located(seen.merged({"left": left, "right": again}))
    assert computer == "right"
    assert (found.epoch, found.cpu, found.errors) == (2, 40.0, 2)
    assert found.error_counts == (replace(error, count=2),)
    (timer,) = found.timers
    assert (timer.releases, timer.missed) == (40, 10)
    assert timer.duration == found.measures["grip"] == found.chains[0].age
    assert timer.duration == Summary(count=40, mean=1.75, maximum=2.0)
    assert found.chains[0].missed == 10
    assert [at for at, each in seen.stays() if each.errors] == ["left", "right"]


def test_many_stays_count_all_the_same() -> None:
    seen = LastSeen()
    for pid in range(1, 201):
        seen.record({"left": running("left", counted(1, 3, 2), pid=pid)})
    assert len(list(seen.stays())) < 60
    ((_, found),) = located(seen.merged({"left": agent("left")}))
    assert (found.timers[0].releases, found.timers[0].missed) == (600, 400)
