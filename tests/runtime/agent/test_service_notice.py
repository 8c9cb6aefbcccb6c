"""An agent that is a service of systemd says that it lives."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from math import inf
from pathlib import Path

import pytest

from poise.runtime.agent.service_notice import ServiceNotice

pytestmark = pytest.mark.slow


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[tuple[socket.socket, dict[str, str]]]:
    """Return the socket of a service manager, and what it gives its service."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(1)
        yield listening, {"NOTIFY_SOCKET": str(tmp_path / "notify")}


def test_it_says_four_times_within_its_limit_that_it_lives(
    systemd: tuple[socket.socket, dict[str, str]],
) -> None:
    listening, environment = systemd
    notice = ServiceNotice(environment | {"WATCHDOG_USEC": "8000000"})
    notice.start(100.0)
    assert listening.recv(100) == b"READY=1"
    notice.live(101.9)
    notice.live(102.0)  # 8 s / 4
    notice.end()
    assert [listening.recv(100) for _ in range(2)] == [b"WATCHDOG=1", b"STOPPING=1"]
    assert notice.due == 104.0


def test_it_has_no_due_moment_without_a_watchdog(
    systemd: tuple[socket.socket, dict[str, str]],
) -> None:
    _, environment = systemd
    others = {"WATCHDOG_USEC": "8000000", "WATCHDOG_PID": "1"}
    for given in ({}, environment, environment | others, {"WATCHDOG_USEC": "1"}):
        notice = ServiceNotice(given)
        notice.start(1.0)
        assert notice.due == inf


def test_what_it_starts_cannot_speak_for_it(
    systemd: tuple[socket.socket, dict[str, str]],
) -> None:
    _, environment = systemd
    ServiceNotice(environment)
    assert environment == {}
