"""Other computers' clocks: asked for over links, and known in every container."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from poise.clock import DRIFT, Elapsed, Stamp, SystemClock
from poise.manage.journal import Journal
from poise.model import load
from poise.runtime.agent.clock_synchronisation import ClockSynchronisation
from poise.runtime.clock_table import ClockTable, ComputerClock, clocks_path
from poise.session.start import Sampling, started
from poise.wire.control_session import open_session
from poise.wire.records.clocks import ClockStatus
from tests.waiting import LIMIT, wait_until

from .conftest import free_port

AHEAD = 5000.0
"""[s] So far one clock is ahead: more than any delay or any test lasts."""
NOON = ClockStatus(offset=AHEAD, error=0.001, at=0.0, trip=0.002)


class Ahead(SystemClock):
    """A clock that is ahead of this computer's."""

    def now(self) -> float:
        return super().now() + AHEAD


def at(folder: Path, now: float) -> ComputerClock:
    """Return a container's clock on `main`, which stands still."""

    class Still(ComputerClock):
        def now(self) -> float:
            return now

    return Still("main", folder)


@pytest.fixture(name="table")
def _table(tmp_path: Path) -> Iterator[ClockTable]:
    table = ClockTable(tmp_path)
    yield table
    table.close()


def test_a_stamp_of_this_computer_needs_no_round_trip(tmp_path: Path) -> None:
    clock = ComputerClock("main", tmp_path)
    since = clock.since(clock.stamp())
    assert since is not None
    assert since.error == 0
    assert 0 <= since.value < LIMIT


def test_knows_nothing_of_a_clock_before_a_round_trip(
    tmp_path: Path, table: ClockTable
) -> None:
    clock = ComputerClock("main", tmp_path)
    assert clock.since(Stamp(1.0, "vision")) is None
    table.write({"vision": NOON})
    assert clock.since(Stamp(1.0, "arm")) is None


def test_knows_nothing_without_an_agent(tmp_path: Path) -> None:
    assert ComputerClock("main", tmp_path).since(Stamp(1.0, "vision")) is None


def test_takes_off_the_offset_and_widens_the_error(
    tmp_path: Path, table: ClockTable
) -> None:
    """Stamped at 5007 there, which is 7 here; 10 is now: 3 s, surer 10 s ago."""
    table.write({"vision": NOON})
    since = at(tmp_path, 10.0).since(Stamp(AHEAD + 7, "vision"))
    assert since is not None
    assert since.value == pytest.approx(3)
    assert since.error == pytest.approx(0.001 + 10 * DRIFT)
    assert since.most == pytest.approx(3.001 + 10 * DRIFT)


def test_sees_what_the_agent_learns_later(tmp_path: Path, table: ClockTable) -> None:
    clock = at(tmp_path, 0.0)
    for offset in (1.0, 2.0):
        table.write({"vision": ClockStatus(offset=offset, error=0, at=0, trip=0)})
        assert clock.since(Stamp(0.0, "vision")) == Elapsed(offset)


def test_goes_on_with_what_it_knew_while_the_agent_writes(
    tmp_path: Path, table: ClockTable
) -> None:
    clock = at(tmp_path, 0.0)
    table.write({"vision": NOON})
    before = clock.since(Stamp(0.0, "vision"))
    with clocks_path(tmp_path).open("r+b") as torn:
        torn.write(b"\x07\x00\x00\x00\xff\xff\xff\xff")
    assert clock.since(Stamp(0.0, "vision")) == before


def test_of_too_many_clocks_some_are_left(tmp_path: Path, table: ClockTable) -> None:
    table.write({f"computer-{n}": NOON for n in range(5000)})
    assert at(tmp_path, 0.0).since(Stamp(0.0, "computer-0")) is not None


@pytest.mark.slow
def test_two_agents_learn_of_each_others_clocks(tmp_path: Path) -> None:
    """One process plays both; its one clock is the truth."""
    port = free_port()
    with ExitStack() as stack:
        known = {}
        for name, clock in (("main", SystemClock()), ("vision", Ahead())):
            session = stack.enter_context(
                open_session(
                    listen=[f"tcp/127.0.0.1:{port}"] if name == "main" else [],
                    connect=[] if name == "main" else [f"tcp/127.0.0.1:{port}"],
                )
            )
            folder = tmp_path / name
            folder.mkdir()
            trips = ClockSynchronisation(session, "poise/test", name, folder, clock)
            trips.start()
            stack.callback(trips.stop)
            known[name] = trips.known
        wait_until(lambda: all(each() for each in known.values()))
        for name, offset in (("main", AHEAD), ("vision", -AHEAD)):
            (seen,) = known[name]().values()
            assert abs(seen.offset - offset) <= seen.error
            assert 0 < seen.trip < LIMIT
            # half a round trip, and what clocks run apart
            assert seen.error <= seen.trip / 2 + DRIFT * LIMIT
        clock = ComputerClock("main", tmp_path / "main")
        wait_until(lambda: clock.since(Stamp(0.0, "vision")) is not None)
        since = clock.since(Ahead("vision").stamp())
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
        for name, other in (("main", "vision"), ("vision", "main")):
            argv = [sys.executable, "-m", "poise", "agent", name, "--robot", "two"]
            argv += ["--address", "127.0.0.1", "--port", str(ports[name])]
            argv += ["--peer", f"127.0.0.1:{ports[other]}"]
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
            status = up.run.agents.statuses()["main"]
            (container,) = status.containers
            found = container.components[0].measures
            return {name: each.median for name, each in found.items() if each.count > 9}

        deadline = time.monotonic() + LIMIT
        while not measures():
            assert time.monotonic() < deadline
            up.run.watch(0.05)
        found = measures()
        clocks = up.run.agents.statuses()["main"].clocks
    assert found["bare"] > AHEAD / 2  # what a bare difference would have said
    assert -found["error"] <= found["age"] < LIMIT
    assert 0 < found["error"] < LIMIT
    assert clocks["vision"].offset == pytest.approx(
        AHEAD, abs=clocks["vision"].error + 1
    )
