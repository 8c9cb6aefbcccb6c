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
    assert [end.messages for end in seen.connectors()] == [31]
    (end,) = connectors_of(seen.merged(on("left", "eye", pid=3)))
    assert end.messages == 31


def test_an_end_that_is_joined_again_in_its_process_counts_on() -> None:
    seen = LastSeen()
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 30)]))
    seen.record(on("left", "eye"))
    seen.record(on("left", "eye", ends=[("eye.x-hand.x", 20)]))
    assert [end.messages for end in seen.connectors()] == [50]


X = "eye.x-hand.x"


def says(
    computer: str, *ends: ConnectorStatus, pid: int = 1, uptime: float = 1.0
) -> dict[str, AgentStatus]:
    container = ContainerStatus(name="arm", pid=pid, connectors=ends)
    return {computer: replace(agent(computer, container), uptime=uptime)}


def source(messages: int, key: str = "0.0") -> ConnectorStatus:
    return ConnectorStatus(
        name=X,
        key=f"{X}/{key}",
        kind="remote",
        end="source",
        ready=True,
        messages=messages,
    )


def target(messages: int, taken: int, key: str = "0.0") -> ConnectorStatus:
    wait = Summary(count=taken)
    return replace(source(messages, key), end="target", wait=wait)


def messages(seen: LastSeen) -> dict[str, int]:
    return {end.end: end.messages for end in seen.connectors()}


def test_what_a_target_that_moves_back_and_forth_got_counts_once() -> None:
    """Amid a move both its places report; the source goes on counting."""
    seen = LastSeen()
    for came in 29, 30:
        seen.record(says("right", target(came, came - 1)))
        paths = source(29), source(30, "0.1")  # one went out meanwhile
        seen.record(says("left", *paths, target(0, 0, "0.1")))
    final = says("left", source(50, "0.1"), target(20, 21, "0.1"))
    assert seen.unprocessed(final) == {}
    assert messages(seen) == {"source": 50, "target": 50}


def test_what_a_source_that_moves_sent_counts_once() -> None:
    seen = LastSeen()
    seen.record(says("left", source(30)) | says("right", target(30, 30)))
    came = target(45, 45, "1.0")
    seen.record(says("far", source(15, "1.0")) | says("right", came))
    assert seen.unprocessed(says("left", source(30))) == {}
    assert messages(seen) == {"source": 45, "target": 45}


def test_what_waits_for_a_component_that_rests_in_the_end_is_not_processed() -> None:
    """It is not placed any more, since its action is done."""
    seen = LastSeen()
    final = says("left", source(13)) | says("right", target(13, 12))
    assert seen.unprocessed(final) == {X: 1}
    final = says("left", source(13)) | says("right", target(12, 12))
    assert LastSeen().unprocessed(final) == {X: 1}


def test_what_waited_as_its_action_ended_waits_for_the_next() -> None:
    seen = LastSeen()
    seen.record(says("left", source(13)) | says("right", target(13, 12)))
    again = says("left", source(5)) | says("right", target(5, 5))
    assert seen.unprocessed(again) == {}
    assert messages(seen) == {"source": 18, "target": 18}


def test_what_waited_in_a_container_that_was_killed_is_not_processed() -> None:
    seen = LastSeen()
    seen.record(says("left", source(13)) | says("right", target(13, 10)))
    final = says("left", source(18)) | says("right", target(5, 5), pid=2)
    assert seen.unprocessed(final) == {X: 3}


def test_a_message_that_was_refused_or_dropped_is_not_waited_for() -> None:
    final = says("left", source(9))
    dropped = replace(target(9, 5), errors=3, drops=1)
    assert LastSeen().unprocessed(final | says("right", dropped)) == {}


def test_what_was_dropped_where_it_was_sent_hides_nothing_that_was_sent() -> None:
    crowded = replace(source(5), drops=9)  # there was no room for nine more
    final = says("left", crowded) | says("right", target(5, 3))
    assert LastSeen().unprocessed(final) == {X: 2}
    both = replace(crowded, end="both", wait=Summary(count=3))
    assert LastSeen().unprocessed(says("left", both)) == {X: 2}


def test_what_made_room_for_newer_messages_is_processed() -> None:
    both = replace(target(5, 3), end="both", drops=1)
    hand = ComponentStatus(name="hand", state="active", keeps={"x": 1})
    container = ContainerStatus(
        name="arm", pid=1, components=(hand,), connectors=(both,)
    )
    assert LastSeen().unprocessed({"left": agent("left", container)}) == {X: 1}


def test_a_status_that_is_older_than_another_changes_nothing() -> None:
    seen = LastSeen()
    seen.record(says("left", source(9), uptime=2.0))
    seen.record(says("left", source(7), uptime=1.0))
    seen.record(says("left", source(11), uptime=3.0))
    assert messages(seen) == {"source": 11}


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


def test_an_end_that_is_joined_again_many_times_counts_all_of_them() -> None:
    seen = LastSeen()
    for _ in range(200):
        seen.record(says("left", source(3)))
        seen.record(says("left", source(1)))
    assert messages(seen) == {"source": 601}
