"""What is seen of a running robot: rates from two statuses, worked out by hand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from msgspec.structs import replace

from poise.manage.observe.chains import ChainHop, ChainReport
from poise.manage.observe.estimates import Load
from poise.session.running_robots.running import Status
from poise.view.robot_view import (
    SPAN,
    ChainRow,
    ComponentRow,
    ConnectorRow,
    Reader,
    TimerRow,
)
from poise.wire.records.request_records import ManagerId
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Summary,
    TimerStatus,
)


def shown(computers: Mapping[str, AgentStatus], **more: Any) -> Status:
    """Return the status of a robot with two computers and two components."""
    return Status(
        robot="r",
        task="work",
        manager=ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0),
        placement={"eye": "left", "mind": "left"},
        computers=computers,
        capacities={
            "left": {"cpu": 2.0, "memory": 1e9},
            "right": {"cpu": 1.0, "memory": 1e9},
        },
        **more,
    )


def seen(
    uptime: float, *, cpu: float, missed: int, sent: int, epoch: int = 0
) -> Status:
    timer = TimerStatus(
        name="look",
        period=0.1,
        deadline=0.1,
        releases=100,
        missed=missed,
        lateness=Summary(),
        duration=Summary(),
    )
    eye = ComponentStatus(
        name="eye", epoch=epoch, state="active", cpu=cpu, timers=(timer,), errors=1
    )
    source = ConnectorStatus(
        name="eye.x-mind.x",
        kind="local",
        end="source",
        ready=True,
        messages=sent,
        bytes_out=sent * 100,
        drops=2,
    )
    target = ConnectorStatus(
        name="eye.x-mind.x", kind="local", end="target", ready=True, drops=3
    )
    container = ContainerStatus(
        name="c", pid=1, at=uptime, components=(eye,), connectors=(target, source)
    )
    agent = AgentStatus(
        computer="left",
        generation=1,
        uptime=uptime,
        cpu=0.0,
        load=0.5,
        memory=1000,
        containers=(container,),
    )
    return shown({"left": agent})


def test_other_programs_count_in_what_a_computer_uses() -> None:
    """Here a core does half as much as the reference's."""
    load = Load(capacity=1.0, used=0.6, background=0.35)
    status = replace(seen(1.0, cpu=0.0, missed=0, sent=0), loads={"left": load})
    left, _ = Reader().update(status, 1.0).computers
    assert left.cpu == pytest.approx(0.5 + 0.7)


def test_rates_are_differences_on_the_time_of_the_container() -> None:
    reader = Reader()
    first = reader.update(seen(10.0, cpu=1.0, missed=5, sent=100), now=0.0)
    assert first.components[0].cpu is None  # nothing to compare with yet
    # the second came late, after 3 s, and the container says that 2 s have passed
    view = reader.update(seen(12.0, cpu=1.5, missed=9, sent=140), now=3.0)
    assert view.components[0] == ComponentRow("eye", "left", "active", 0.25, 2.0, 1)
    assert view.connectors == (
        ConnectorRow("eye.x-mind.x", "local", True, 20.0, 2000.0, 5, 0),
    )
    assert view.timers == (TimerRow("eye.look", "eye", "left", 0.1, 0.0, 2.0),)


def test_rates_are_means_of_the_last_seconds() -> None:
    reader = Reader()
    for second in range(10):
        sent = 10 * second if second < 5 else 40 + 100 * (second - 4)
        view = reader.update(
            seen(float(second), cpu=0.0, missed=0, sent=sent), float(second)
        )
    assert SPAN < 4
    assert view.connectors[0].rate == pytest.approx(100.0)


def test_what_began_again_has_no_rate_below_nothing() -> None:
    reader = Reader()
    reader.update(seen(10.0, cpu=9.0, missed=9, sent=900), 0.0)
    view = reader.update(seen(11.0, cpu=0.1, missed=0, sent=3), 1.0)
    assert view.components[0].cpu == 0.0
    assert view.connectors[0].rate == 0.0
    view = reader.update(seen(12.0, cpu=0.2, missed=0, sent=3, epoch=1), 2.0)
    assert view.components[0].cpu is None  # not yet known, and not 0 %


def test_what_is_missing_is_shown_as_missing() -> None:
    view = Reader().update(seen(1.0, cpu=0.0, missed=0, sent=0), 0.0)
    assert view.components[1] == ComponentRow(
        "mind", "left", "not there", None, None, 0
    )
    left, right = view.computers
    assert (left.name, left.cpu, left.cores, left.components) == ("left", 0.5, 2.0, 2)
    assert left.is_reached
    assert not right.is_reached


def test_components_of_a_computer_out_of_reach_are_unknown() -> None:
    status = seen(1.0, cpu=0.0, missed=0, sent=0)
    lost = shown(status.computers, out_of_reach={"left": 1.0})
    assert Reader().update(lost, 0.0).components[0].state == "unknown"


def test_a_stale_end_does_not_say_how_a_connector_is_now() -> None:
    """The mind was beside the eye on a computer that froze, and was restarted."""
    status = seen(1.0, cpu=0.0, missed=0, sent=0)
    old = status.computers["left"].containers[0].connectors
    there = ConnectorStatus(
        name="eye.x-mind.x", kind="remote", end="target", ready=True
    )
    container = ContainerStatus(name="d", pid=2, at=1.0, connectors=(there,))
    right = AgentStatus(
        computer="right", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    now = replace(
        status, computers={**status.computers, "right": right}, ages={"left": 9.0}
    )
    assert {end.kind for end in old} == {"local"}
    (row,) = Reader().update(now, 0.0).connectors
    assert (row.kind, row.rate) == ("remote", None)


def aged(uses: int, missed: int, at: float = 1.0, **more: Any) -> Status:
    hop = ChainHop(component="mind", computer="left")
    chain = ChainReport(
        name="see",
        deadline=0.1,
        missed=missed,
        age=Summary(count=uses, mean=0.05),
        error=0.0,
        hops=(hop,),
    )
    agent = AgentStatus(computer="left", generation=1, uptime=at, cpu=0.0)
    return shown({"left": agent}, chains=(chain,), **more)


def test_a_chain_is_late_by_its_last_uses_and_unknown_without() -> None:
    reader = Reader()
    late = [
        view.chains[0].late
        for view in (
            reader.update(aged(1000, 0), 0.0),
            reader.update(aged(1010, 9), 1.0),
            reader.update(aged(1030, 9), 4.5),
            reader.update(aged(1030, 9), 8.0),
            reader.update(aged(1040, 9, ages={"left": 9.0, "right": 0.1}), 9.0),
        )
    ]
    # over three seconds: 9 of 10, none of 20, no use, and a computer that is silent
    assert late == [None, 0.9, 0.0, None, None]


def test_a_chain_that_was_not_used_has_no_age() -> None:
    (row,) = Reader().update(aged(0, 0), 0.0).chains
    assert row == ChainRow("see", None, None, 0.1, 0, None)
