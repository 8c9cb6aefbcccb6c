"""Until when an agent lets its leased components act."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

import pytest

from poise.endpoint import Endpoint
from poise.runtime.agent.fence import Fence
from poise.runtime.agent.heartbeat_exchange import HeartbeatExchange
from poise.testing.clock import VirtualClock
from poise.wire.failure_detector import LEASE, UNCUT_LEASE
from poise.wire.records.requests import Claim, ManagerId
from tests.runtime.conftest import free_port

pytestmark = pytest.mark.slow  # it opens a socket

AGENTS = {"left": "tcp/127.0.0.1:1", "right": "tcp/127.0.0.1:2"}
MANAGER = ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0)


class Rig:
    """The heartbeats of an agent, which a test lets go out by itself."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.clock.sleep(100.0)
        self.asleep = 0.0
        self.ends: list[float] = []
        self.fence = Fence("robot", "left", lambda: None, lambda _: None)
        self.fence.claim(Claim(MANAGER), 1)
        self.exchange = HeartbeatExchange(
            "robot",
            "left",
            Endpoint("127.0.0.1", free_port()),
            self.fence,
            self.clock,
            self.ends.append,
            lambda: self.asleep,
        )
        assert self.exchange._heartbeats is not None
        self.exchange._heartbeats.start = lambda: None  # type: ignore[method-assign]

    def beat(self, after: float) -> float:
        """Return until when components may act, from now [s]."""
        self.clock.sleep(after)
        self.exchange._next_beat()
        return self.ends[-1] - self.asleep - self.clock.now()


@pytest.fixture
def rig() -> Iterator[Rig]:
    rig = Rig()
    yield rig
    rig.exchange.close()


def test_components_of_the_only_computer_pay_nothing(rig: Rig) -> None:
    rig.exchange.begin("k", {"left": AGENTS["left"]}, is_leased=True)
    assert rig.ends == [inf]


def test_where_nothing_is_cut_it_is_enough_that_the_agent_runs(rig: Rig) -> None:
    rig.exchange.begin("k", AGENTS, is_leased=False)
    assert rig.beat(0.1) == pytest.approx(UNCUT_LEASE)
    assert rig.beat(9.0) == pytest.approx(UNCUT_LEASE)
    assert rig.beat(11.0) == -inf
    assert rig.fence.is_cut_off


def test_the_next_agent_extends_nothing_before_it_is_heard(rig: Rig) -> None:
    rig.exchange.begin_again(AGENTS, is_leased=True)
    assert rig.ends == [-inf]
    assert rig.beat(0.1) == -inf
    assert not rig.fence.is_cut_off
    rig.beat(LEASE)
    rig.beat(0.2)  # it stood still, and has listened
    assert rig.fence.is_cut_off


def test_an_agent_goes_on_by_itself_only_while_it_runs_and_no_manager_may_be_there(
    rig: Rig,
) -> None:
    rig.exchange.begin_again(AGENTS, is_leased=True)
    rig.fence._ended.add("k")
    rig.beat(0.1)
    assert rig.beat(LEASE) == -inf  # it stood still for so long: first it listens
    assert rig.beat(0.2) == pytest.approx(LEASE)
    assert rig.beat(3.0) == -inf
    assert rig.beat(0.2) == pytest.approx(LEASE)
    assert not rig.fence.is_cut_off


def test_a_computer_that_was_suspended_has_lost_its_lease(rig: Rig) -> None:
    rig.exchange.begin("k", AGENTS, is_leased=True)
    assert rig.beat(0.1) == pytest.approx(LEASE)
    rig.asleep = 60.0
    # what its containers read ended while it slept
    assert rig.ends[-1] < rig.clock.now() + rig.asleep
    assert rig.beat(0.01) == -inf
    assert rig.fence.is_cut_off
