"""Late data is dropped, not waited for, when a link of three computers is cut."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import poise
from examples.demo.waiting import measures
from poise.emulate import EmulatedSet
from poise.manage.agent_connections.statuses import connectors_of
from poise.manage.migration.migration_report import MigrationReport
from poise.session.placing.placement import place
from poise.session.running_robots.running import RolledBack, Running
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

ACTS_WITHIN = 20.0
"""A move hung for as long as the link was cut; now it takes 3 s, on a quiet machine."""
PATH = """
from contextlib import suppress
from typing import Protocol

from poise import CallError, Component, Message, Provided, Published, Required
from poise import every, subscribed

class Tick(Message):
    n: int

class Source(Component):
    tick: Published[Tick]

    def configure(self) -> None:
        self.n = 0

    @every(0.05)
    def go(self) -> None:
        self.n += 1
        self.tick.publish(Tick(self.n))

class Mid(Component):
    out: Published[Tick]

    @subscribed(keep=1)
    def tick(self, m: Tick) -> None:
        self.out.publish(m)

class Sink(Component):
    last = came = wrong = 0

    def take(self, m: Tick) -> None:
        self.wrong += m.n <= self.last
        self.last, self.came = m.n, self.came + 1
        for name in ("came", "wrong"):
            self.measure(name, getattr(self, name))

class Keeps(Sink):
    @subscribed(keep=1)
    def out(self, m: Tick) -> None:
        self.take(m)

class Blocks(Sink):
    @subscribed(block=100)
    def out(self, m: Tick) -> None:
        self.take(m)

class Asks(Protocol):
    def ask(self) -> int: ...

class Hub(Component):
    asks: Provided[Asks]

    def ask(self) -> int:
        return 1

class Caller(Component):
    asks: Required[Asks]

    @every(0.1)
    def go(self) -> None:
        with suppress(CallError):
            self.asks.ask()
"""
ROBOT = """
robot: {name}
computers:
  a: {{cpu: 0.5, memory: 1 GiB}}
  b: {{cpu: 0.5, memory: 1 GiB}}
  c: {{cpu: 0.5, memory: 1 GiB}}
links:
  - {{between: [a, b], bandwidth: 100 Mbit/s}}
  - {{between: [a, c], bandwidth: 100 Mbit/s}}
  - {{between: [b, c], bandwidth: 100 Mbit/s}}
architectures:
  main:
    function: main
    components:
      source: {{implementation: "path:Source", cpu: 2%, only: [c]}}
      mid: {{implementation: "path:Mid", cpu: 2%}}
      sink: {{implementation: "path:SINK", cpu: 2%, only: [b]}}
      hub: {{implementation: "path:Hub", cpu: 2%, only: [b], isolated: true}}
      caller: {{implementation: "path:Caller", cpu: 2%, only: [c], isolated: true}}
    connectors:
      - {{between: [source.tick, mid.tick], message: 20 B, rate: 20 Hz}}
      - {{between: [mid.out, sink.out], message: 20 B, rate: 20 Hz}}
      - {{between: [caller.asks, hub.asks], message: 20 B, rate: 10 Hz, limit: 0.1 s}}
tasks:
  go: {{actions: [{{name: go, functions: [main]}}]}}
"""
PLACEMENT = "{source: c, mid: a, sink: b, hub: b, caller: c}"


@pytest.fixture
def file(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    return written(
        tmp_path, "cut-links", "path", PATH, ROBOT.replace("SINK", request.param)
    )


@pytest.fixture
def running(file: Path, emulated: EmulatedSet) -> Iterator[Running]:  # noqa: ARG001, there first
    robot = poise.load(file)
    where = file.with_name("place.yaml")
    where.write_text(PLACEMENT)
    placement = place(robot, method=str(where))
    with poise.up(robot, placement=placement, adapt=False, say=print) as running:
        wait_long(lambda: measures(running).get("came", 0) > 10)
        yield running


def is_cut(running: Running) -> bool:
    return any("is cut" in each.what for each in running.status().deviations)


def cut(running: Running, emulated: EmulatedSet, other: str = "b") -> None:
    """Cut a from another computer, and wait until Poise knows."""
    emulated.cut("a", other)
    wait_long(lambda: is_cut(running))


def heal(running: Running, emulated: EmulatedSet, other: str = "b") -> None:
    """Heal that; nothing late comes then after what is newer."""
    emulated.heal("a", other)
    wait_long(lambda: not is_cut(running))
    before = measures(running)["came"]
    wait_long(lambda: measures(running)["came"] > before + 20)
    assert measures(running)["wrong"] == 0


def moved(running: Running, computer: str) -> tuple[MigrationReport, float]:
    began = time.monotonic()
    report = running.move("mid", computer)
    return report, time.monotonic() - began


@pytest.mark.parametrize("file", ["Keeps"], indirect=True)
@pytest.mark.parametrize("known", ["by heartbeats", "by its connection, too"])
def test_a_component_leaves_a_cut_link_with_what_is_late_dropped(
    running: Running, emulated: EmulatedSet, known: str
) -> None:
    """It hung in its preparation for as long as the link was cut."""
    cut(running, emulated)
    if known == "by its connection, too":
        wait_long(lambda: "mid.out-sink.out" in unjoined(running))
    report, took = moved(running, "c")
    assert report.dropped == {"mid.out-sink.out": "link 'a-b' is cut"}
    assert took < ACTS_WITHIN
    before = measures(running)["came"]
    wait_long(lambda: measures(running)["came"] > before + 20)
    heal(running, emulated)


@pytest.mark.parametrize("file", ["Keeps"], indirect=True)
def test_a_component_gets_no_late_data_after_it_left_the_link_to_its_source(
    running: Running, emulated: EmulatedSet
) -> None:
    cut(running, emulated, "c")
    report, took = moved(running, "b")
    assert report.dropped == {"source.tick-mid.tick": "link 'a-c' is cut"}
    assert took < ACTS_WITHIN
    before = measures(running)["came"]
    wait_long(lambda: measures(running)["came"] > before + 20)
    heal(running, emulated, "c")


@pytest.mark.parametrize("file", ["Blocks"], indirect=True)
def test_a_component_that_may_lose_nothing_stays_and_the_reason_names_the_link(
    running: Running, emulated: EmulatedSet
) -> None:
    cut(running, emulated)
    began = time.monotonic()
    with pytest.raises(RolledBack) as caught:
        running.move("mid", "c")
    assert time.monotonic() - began < ACTS_WITHIN
    assert (
        "connector 'mid.out-sink.out' cannot be drained: link 'a-b' is cut; "
        "'sink.out' has no `keep`, so nothing may be lost"
    ) in str(caught.value)
    heal(running, emulated)
    assert moved(running, "c")[0].committed
    assert measures(running)["wrong"] == 0


@pytest.mark.parametrize("file", ["Keeps"], indirect=True)
def test_a_frozen_container_holds_up_no_move_of_others(running: Running) -> None:
    """Each waited for 30 s for a connector between two components that stay."""
    containers = running.status().computers["b"].containers
    (pid,) = (each.pid for each in containers if "hub" in each.name)
    os.kill(pid, signal.SIGSTOP)
    try:
        wait_long(lambda: "caller.asks-hub.asks" in unjoined(running))
        for computer in ("c", "a"):
            report, took = moved(running, computer)
            assert report.committed
            assert took < ACTS_WITHIN
    finally:
        os.kill(pid, signal.SIGCONT)
    assert measures(running)["wrong"] == 0


def unjoined(running: Running) -> set[str]:
    connectors = connectors_of(running.status().computers)
    return {each.name for each in connectors if not each.ready}
