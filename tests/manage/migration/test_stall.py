"""When a preparation has come to a standstill, by a clock that the test moves."""

from __future__ import annotations

from typing import cast
from unittest.mock import Mock

import pytest

from poise.errors import RunError
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.pending_migration import STALL_LIMIT, Stall
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
    ContainerStatus,
    Fault,
    State,
)

TARGET = Incarnation(component="mid", computer="c", epoch=1, goal="inactive")
STARTING = ContainerHealth(name="main", state="starting", since=0.0)


class Preparation:
    """A preparation that misses what the test says, at a time that it says."""

    def __init__(self) -> None:
        self.now = 0.0
        self.run = Mock(**{"layout.container_at.return_value": ("c", "main")})
        self.misses("connector 'a.out-mid.in' is not joined")
        self.is_at("inactive")
        self.has_faults()
        live = cast("LiveRobot", self.run)
        self.stall = Stall(live, lambda: self.now)
        self.stall.check(self.run.missing(), [TARGET])

    def misses(self, *what: str) -> None:
        self.run.missing.return_value = list(what)

    def is_at(self, state: State, *health: ContainerHealth) -> None:
        component = ComponentStatus(name="mid", epoch=1, state=state)
        container = ContainerStatus(name="main", pid=1, components=(component,))
        self.run.current.return_value = {
            "c": AgentStatus(
                computer="c",
                generation=1,
                uptime=0,
                cpu=0,
                containers=(container,),
                health=health,
            )
        }

    def has_faults(self, *faults: Fault) -> None:
        self.run.agents.statuses.return_value = {
            "c": AgentStatus(computer="c", generation=1, uptime=0, cpu=0, faults=faults)
        }

    def look_after(self, seconds: float) -> None:
        self.now += seconds
        self.stall.check(self.run.missing(), [TARGET])


def test_a_preparation_without_progress_ends_and_says_what_is_missing() -> None:
    preparation = Preparation()
    preparation.look_after(STALL_LIMIT)
    with pytest.raises(RunError, match=r"for 2 s: connector 'a.out-mid.in' is not"):
        preparation.look_after(0.1)


def test_a_preparation_that_misses_something_else_goes_on() -> None:
    preparation = Preparation()
    preparation.look_after(STALL_LIMIT - 0.1)
    preparation.misses("connector 'b.out-mid.in' is not joined")
    preparation.look_after(0.1)
    preparation.look_after(STALL_LIMIT)
    with pytest.raises(RunError, match=r"'b\.out-mid\.in'"):
        preparation.look_after(0.1)


def test_users_code_may_take_longer_to_be_configured() -> None:
    preparation = Preparation()
    preparation.is_at("unconfigured")
    preparation.look_after(10 * STALL_LIMIT)
    preparation.is_at("inactive")
    with pytest.raises(RunError):
        preparation.look_after(STALL_LIMIT + 0.1)


def test_a_container_may_take_longer_to_start() -> None:
    preparation = Preparation()
    preparation.is_at("inactive", STARTING)
    preparation.look_after(10 * STALL_LIMIT)


def test_code_that_ends_its_container_ends_the_preparation_at_once() -> None:
    """It was tried seven times, each of which ended what else worked there."""
    preparation = Preparation()
    preparation.is_at("unconfigured")
    other = Fault(container="other", message="ended with exit code 1", number=1)
    preparation.has_faults(other)
    preparation.look_after(0.1)
    fault = Fault(container="main", message="ended with exit code 3", number=2)
    preparation.has_faults(other, fault)
    with pytest.raises(RunError, match="'main' on 'c' ended with exit code 3"):
        preparation.look_after(0.1)
