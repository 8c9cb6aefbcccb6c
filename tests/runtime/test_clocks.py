"""Other computers' clocks: known by heartbeats, and in every container."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from poise.clock import DRIFT, Stamp, SystemClock
from poise.endpoint import Endpoint
from poise.manage.journal import Journal
from poise.model import load
from poise.runtime.agent.fence import Fence
from poise.runtime.agent.heartbeat_exchange import HeartbeatExchange
from poise.runtime.execution.data_age import ComputerClock
from poise.runtime.supervision.container_processes import ContainerProcess
from poise.runtime.supervision.health import Silence
from poise.runtime.supervision.process_host import ControlLink
from poise.session.launch.start import Sampling, started
from poise.waker import wait_readable
from poise.wire import frame
from poise.wire.control_session import locator
from poise.wire.heartbeats import Contacts, Heartbeats, UdpDatagrams
from poise.wire.records.deployment_records import ContainerSpec
from poise.wire.records.heartbeat_records import Clocks, ClockStatus
from poise.wire.records.request_records import Claim, ManagerId
from poise.wire.records.status_records import ToContainer
from tests.waiting import LIMIT, wait_until

from .conftest import free_port

AHEAD = 5000.0
"""[s] So far one clock is ahead: more than any delay or any test lasts."""
NOON = ClockStatus(offset=AHEAD, error=0.001, at=0.0, trip=0.002)


class Ahead(SystemClock):
    """A clock that is ahead of this computer's."""

    def now(self) -> float:
        return super().now() + AHEAD


class Still(ComputerClock):
    """A container's clock on `main`, which stands still."""

    def __init__(self, now: float, **others: ClockStatus) -> None:
        super().__init__("main")
        self.others = others
        self._now = now

    def now(self) -> float:
        return self._now


def test_a_stamp_of_this_computer_needs_no_round_trip() -> None:
    clock = ComputerClock("main")
    since = clock.since(clock.stamp())
    assert since is not None
    assert since.error == 0
    assert 0 <= since.value < LIMIT


def test_knows_nothing_of_a_clock_before_a_round_trip() -> None:
    assert Still(1.0).since(Stamp(1.0, "vision")) is None
    assert Still(1.0, vision=NOON).since(Stamp(1.0, "arm")) is None


def test_takes_off_the_offset_and_widens_the_error() -> None:
    """Stamped at 5007 there, which is 7 here; 10 is now: 3 s, surer 10 s ago."""
    since = Still(10.0, vision=NOON).since(Stamp(AHEAD + 7, "vision"))
    assert since is not None
    assert since.value == pytest.approx(3)
    assert since.error == pytest.approx(0.001 + 10 * DRIFT)
    assert since.most == pytest.approx(3.001 + 10 * DRIFT)


@pytest.mark.slow
def test_a_container_is_told_what_is_new_while_it_responds() -> None:
    agent, container = socket.socketpair()
    spec = ContainerSpec(name="one", folder="", components=(), connectors=())
    with agent, container:
        process = ContainerProcess(spec, ControlLink("one", agent, -1))
        assert frame.receive_record(container, ToContainer) == spec
        for known in ({}, {"vision": NOON}, {"vision": NOON}):
            process.send_clocks(Clocks(known))
        assert frame.receive_record(container, ToContainer) == Clocks({"vision": NOON})
        process.silence = Silence(
            container="one", pid=1, seconds=2.0, reason="it is stopped"
        )
        process.send_clocks(Clocks({"arm": NOON}))
        assert not wait_readable([container.fileno()], 0.0)
        process.silence = None
        process.send_clocks(Clocks({"arm": NOON}))
        assert frame.receive_record(container, ToContainer) == Clocks({"arm": NOON})


@pytest.mark.slow
def test_two_agents_learn_of_each_others_clocks() -> None:
    """One process plays both; its one clock is the truth."""
    clocks = {"main": SystemClock(), "vision": Ahead()}
    where = {name: Endpoint("127.0.0.1", free_port()) for name in clocks}
    agents = {name: locator(each) for name, each in where.items()}
    with ExitStack() as stack:
        exchanges = {}
        manager = ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0)
        for name, clock in clocks.items():
            exchanges[name] = each = HeartbeatExchange(
                name,
                Contacts("test", name, name),
                Fence("test", name, lambda: None, lambda _: None),
                clock,
                partial(Heartbeats, clock, datagrams=UdpDatagrams(clock, where[name])),
                lambda _: None,
                lambda: 0.0,
            )
            stack.callback(each.close)
            each.obey(Claim(manager, agents=agents))
        wait_until(lambda: all(each.clocks for each in exchanges.values()))
        for name, offset in (("main", AHEAD), ("vision", -AHEAD)):
            (seen,) = exchanges[name].clocks.values()
            assert abs(seen.offset - offset) <= seen.error
            assert 0 < seen.trip < LIMIT
            # half a round trip, and what clocks run apart
            assert seen.error <= seen.trip / 2 + DRIFT * LIMIT
            assert not exchanges[name].links()  # of links that nothing can cut
        here = ComputerClock("main")
        here.others = exchanges["main"].clocks
        since = here.since(Ahead("vision").stamp())
        assert since is not None
        assert -since.error <= since.value < LIMIT


ROBOT = """
robot: two
computers:
  main: {{cpu: 1, memory: 1 GiB, address: "127.0.0.1:{main}"}}
  vision: {{cpu: 1, memory: 1 GiB, address: "127.0.0.1:{vision}"}}
architectures:
  looking:
    function: looking
    components:
      eye: {{implementation: "eyes:Eye"}}
      brain: {{implementation: "eyes:Brain"}}
    connectors: [{{between: [eye.seen, brain.seen]}}]
tasks: {{look: {{actions: [{{name: look, functions: [looking]}}]}}}}
"""
EYES = """
from poise import Component, Message, Published, Stamp, every, subscribed

class Seen(Message):
    stamp: Stamp

class Eye(Component):
    seen: Published[Seen]

    @every(0.02)
    def look(self) -> None:
        self.seen.publish(Seen(self.clock.stamp()))

class Brain(Component):
    @subscribed(keep=10)
    def seen(self, message: Seen) -> None:
        age = self.clock.since(message.stamp)
        if age is not None:
            self.measure("age", age.value)
            self.measure("error", age.error)
            self.measure("bare", message.stamp.at - self.clock.now())
"""


def _has_time_namespaces() -> bool:
    shifted = ["unshare", "--time", "--monotonic", "5000", "true"]
    try:
        return subprocess.run(shifted, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(
    not _has_time_namespaces(), reason="needs root, for a shifted clock"
)
def test_the_age_of_a_message_from_a_computer_whose_clock_is_ahead(
    tmp_path: Path,
) -> None:
    """`vision`, its agent and its containers, are in a time namespace 5000 s ahead."""
    ports = {"main": free_port(), "vision": free_port()}
    (tmp_path / "robot.yaml").write_text(ROBOT.format(**ports))
    (tmp_path / "eyes.py").write_text(EYES)
    with ExitStack() as stack:
        for name, port in ports.items():
            argv = [sys.executable, "-m", "poise", "agent", name, "--robot", "two"]
            argv += ["--address", "127.0.0.1", "--port", str(port)]
            if name == "vision":
                argv = ["unshare", "--time", "--monotonic", str(int(AHEAD)), *argv]
            agent = subprocess.Popen(argv)
            stack.callback(agent.wait, LIMIT)
            stack.callback(agent.terminate)
        robot = load(tmp_path / "robot.yaml")
        placement = {"eye": "vision", "brain": "main"}
        journal = Journal(":memory:")
        stack.callback(journal.close)
        up = stack.enter_context(
            started(robot, placement, journal, lambda _: None, Sampling())
        )

        def measures() -> dict[str, float]:
            status = up.live.agents.statuses()["main"]
            (container,) = status.containers
            found = container.components[0].measures
            return {name: each.median for name, each in found.items() if each.count > 9}

        deadline = time.monotonic() + LIMIT
        while not measures():
            assert time.monotonic() < deadline
            up.live.watch(0.05)
        found = measures()
        clocks = up.live.agents.statuses()["main"].clocks
    assert found["bare"] > AHEAD / 2  # what a bare difference would have said
    assert -found["error"] <= found["age"] < LIMIT
    assert 0 < found["error"] < LIMIT
    assert clocks["vision"].offset == pytest.approx(
        AHEAD, abs=clocks["vision"].error + 1
    )
