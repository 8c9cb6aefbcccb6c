"""What comes from agents, or from whoever says that it is one."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from poise.clock import SystemClock
from poise.manage.agent_connections.reports import MOST_REFUSED, AgentReports, reading
from poise.wire.records.status import (
    AgentStatus,
    ComponentStatus,
    ContainerStatus,
    Summary,
    TaskWish,
    TimerStatus,
)

LATE = TimerStatus(
    name="tick",
    period=0.1,
    deadline=0.1,
    releases=1,
    missed=1,
    lateness=Summary(),
    duration=Summary(),
)


class Payload:
    """What zenoh hands over."""

    key_expr = "poise/robot/status/left"

    def __init__(self, body: bytes) -> None:
        self.payload = self
        self._body = body

    def to_bytes(self) -> bytes:
        return self._body


@pytest.fixture
def reports() -> AgentReports:
    return AgentReports("robot", {"left": "tcp/127.0.0.1:1"}, SystemClock())


def test_why_a_record_is_refused_is_told_once_and_the_next_one_taken(
    reports: AgentReports, caplog: pytest.LogCaptureFixture
) -> None:
    hear: Any = reading(AgentStatus, reports.take_status, reports.on_refused)
    for _ in range(3):
        hear(Payload(b"\xc1 nonsense"))
    assert caplog.text == ""  # whoever logs may have to wait for what shows it
    (why,) = reports.take_refused()
    assert why.startswith("a record at poise/robot/status/left was refused: ")
    hear(Payload(b"\xc1 nonsense"))
    assert reports.take_refused() == []
    status = AgentStatus(computer="left", generation=1, uptime=0.0, cpu=0.0)
    hear(Payload(msgspec.msgpack.encode(status)))
    assert reports.statuses() == {"left": status}


def _status(*components: ComponentStatus, uptime: float = 0.0) -> AgentStatus:
    container = ContainerStatus(name="all", pid=1, components=components)
    return AgentStatus(
        computer="left", generation=1, uptime=uptime, cpu=0.0, containers=(container,)
    )


def test_a_status_that_only_counts_on_is_no_change(reports: AgentReports) -> None:
    arm = ComponentStatus(name="arm", state="active")
    reports.take_status(_status(arm))
    before = reports.num_changes
    reports.take_status(_status(replace(arm, cpu=1.0), uptime=1.0))
    assert reports.num_changes == before


@pytest.mark.parametrize(
    "change",
    [
        {"state": "failed"},
        {"wishes": (TaskWish(number=1, verb="start", task="fetch"),)},
        {"timers": (LATE,)},
    ],
)
def test_a_status_that_says_something_new_is_a_change(
    reports: AgentReports, change: dict[str, object]
) -> None:
    arm = ComponentStatus(name="arm", state="active")
    reports.take_status(_status(arm))
    before = reports.num_changes
    reports.take_status(_status(replace(arm, **change)))
    assert reports.num_changes == before + 1


def test_keeps_a_bounded_number_of_reasons(reports: AgentReports) -> None:
    for number in range(2 * MOST_REFUSED):
        reports.on_refused(f"reason {number}")
    assert len(reports.take_refused()) == MOST_REFUSED
