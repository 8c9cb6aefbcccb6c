"""What comes from agents, or from whoever says that it is one."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable, Mapping
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import zenoh

from poise.clock import SystemClock
from poise.errors import RunError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.reports import MOST_REFUSED, AgentReports, reading
from poise.wire.records.status_records import AgentStatus
from tests.waiting import LONG

UNDECLARED = """
from poise.clock import SystemClock
from poise.manage.agent_connections.agents import Agents

class Full(Agents):
    def subscribe(self, _):
        raise RuntimeError("can't start new thread")

Full("hello", {}, SystemClock())
"""


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
    hear: Any = reading(AgentStatus, reports.store_status, reports.on_refused)
    for _ in range(3):
        hear(Payload(b"\xc1 nonsense"))
    assert caplog.text == ""  # whoever logs may have to wait for what shows it
    (why,) = reports.pop_refused()
    assert why.startswith("a record at poise/robot/status/left was refused: ")
    hear(Payload(b"\xc1 nonsense"))
    assert reports.pop_refused() == []
    status = AgentStatus(computer="left", generation=1, uptime=0.0, cpu=0.0)
    hear(Payload(msgspec.msgpack.encode(status)))
    assert reports.statuses() == {"left": status}


def test_keeps_a_bounded_number_of_reasons(reports: AgentReports) -> None:
    for number in range(2 * MOST_REFUSED):
        reports.on_refused(f"reason {number}")
    assert len(reports.pop_refused()) == MOST_REFUSED


@pytest.mark.parametrize(
    ("silent", "said"),
    [
        ("", "voted, and does not confirm that"),
        ("bc", "does not answer heartbeats (UDP): b, c (does a firewall let them"),
    ],
)
def test_says_when_heartbeats_keep_a_manager_from_leading(
    silent: str, said: str
) -> None:
    """A firewall without UDP was no reason that anyone could see."""
    agents: Any = Agents.__new__(Agents)
    agents.heartbeats = SimpleNamespace(answers=lambda name: name not in silent)
    assert said in agents._why_unconfirmed(["c", "a", "b"])


def test_a_computer_is_lost_since_it_was_silent(reports: AgentReports) -> None:
    reports.on_alive(token("PUT"))
    reports.on_silent(["left"])
    since = reports.out_of_reach()["left"]
    reports.on_alive(token("DELETE"))
    reports.on_silent([])
    reports.go_on_without_missing()
    assert reports.out_of_reach() == {"left": since}


def token(kind: str) -> Any:
    """Return what says that the agent of 'left' came or went."""
    sort = getattr(zenoh.SampleKind, kind)
    return SimpleNamespace(key_expr="poise/robot/alive/left", kind=sort)


@pytest.mark.slow
def test_a_process_ends_that_cannot_hear_agents() -> None:
    """As where no thread is free; those of zenoh would go on."""
    done = subprocess.run(
        [sys.executable, "-c", UNDECLARED],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 1
    assert "can't start new thread" in done.stderr


def test_says_why_agents_are_silent() -> None:
    ends = {name: f"tcp/{name}.local:1" for name in ("left", "right")}
    reports = AgentReports("robot", ends, SystemClock())

    def why_silent(names: Iterable[str]) -> Mapping[str, str]:
        return dict.fromkeys(names, "no name server")

    with pytest.raises(RunError, match="left: no name server\nright: no name server"):
        reports.wait_alive(ends, 0.0, why_silent=why_silent)
