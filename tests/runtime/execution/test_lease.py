"""A leased component does nothing that others see after its lease has ended."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from math import inf
from pathlib import Path
from typing import Protocol
from unittest.mock import Mock

import pytest

from poise import Component, Message, Provided, Published, Required, every, subscribed
from poise.clock import SystemClock
from poise.errors import Unavailable
from poise.runtime.connectors.latest import LatestMessages
from poise.runtime.execution.container_lease import LeaseEnd, LeaseEnded, check_lease
from poise.runtime.execution.counters import Counts, new_memory
from poise.runtime.hosting.checkpoints import Checkpoints
from poise.runtime.hosting.command_line import freeze_fenced
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration.state_transfer import REQUEST, Request, StateSender
from poise.wire import frame
from poise.wire.frame import FrameKind
from poise.wire.records.deployment_records import ComponentSpec
from tests.runtime.conftest import Pair
from tests.runtime.hosting.test_command_line import reach, runner_of
from tests.waiting import LIMIT, wait_until

apart = pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)


@pytest.fixture
def memory() -> Iterator[int]:
    memory = new_memory()
    yield memory
    os.close(memory)


@pytest.fixture
def lease(memory: int) -> LeaseEnd:
    lease = LeaseEnd(memory)
    lease.at = inf
    return lease


def boot_time() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Number(Message):
    value: int


class Counter(Component):
    """Counts what it does, and waits in a handler when it is asked to."""

    said: Published[Number]
    ticks = activations = 0

    def configure(self) -> None:
        self.heard: list[int] = []

    def activate(self) -> None:
        self.activations += 1

    def deactivate(self) -> None:
        self.said.publish(Number(0))

    @every(0.001)
    def tick(self) -> None:
        self.ticks += 1

    @subscribed(keep=10)
    def numbers(self, message: Number) -> None:
        self.heard.append(message.value)

    def snapshot(self) -> Number:
        return Number(self.ticks)


@pytest.fixture
def runner(lease: LeaseEnd) -> Iterator[Runner]:
    spec = ComponentSpec(name="one", goal="inactive", leased=True)
    runner = Runner(spec, Counter, SystemClock(), lambda: None)
    runner.lease = lease
    runner.start()
    yield runner
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)


def counter(runner: Runner) -> Counter:
    assert isinstance(runner.component, Counter)
    return runner.component


def test_a_lease_starts_in_the_past_and_is_written_by_the_other_end(
    memory: int,
) -> None:
    ours, theirs = LeaseEnd(memory), LeaseEnd(memory)
    assert ours.is_past()
    for at, is_past in (
        (boot_time() + 100.0, False),
        (boot_time() - 0.001, True),
        (inf, False),
        (-inf, True),
    ):
        theirs.at = at
        assert ours.at == at
        assert ours.is_past() == is_past


def test_timers_and_messages_wait_until_the_lease_is_extended(
    runner: Runner, lease: LeaseEnd
) -> None:
    component = counter(runner)
    runner.aim("active")
    wait_until(lambda: component.ticks)
    lease.at = boot_time()
    runner.exclusion.enter(7, LIMIT)  # once no handler runs
    before = component.ticks
    runner.exclusion.leave()
    feed = runner.endpoints.mailbox.feed("numbers", Counts())
    feed.put((0, Number(3)))
    due = time.monotonic() + 0.1
    wait_until(lambda: time.monotonic() > due)  # a hundred releases
    assert (component.ticks, component.heard) == (before, [])
    assert runner.hang() == ("", 0.0)
    lease.at = inf
    wait_until(lambda: component.heard == [3])
    wait_until(lambda: component.ticks > before)


def test_a_lease_that_ends_amid_a_handler_is_no_error_of_its_code(
    runner: Runner,
    lease: LeaseEnd,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    component = counter(runner)

    def send_late(_message: Number) -> None:
        lease.at = boot_time()
        check_lease(lease, "one")  # as all does that sends

    monkeypatch.setattr(component, "numbers", send_late)
    runner.aim("active")
    wait_until(lambda: component.ticks)
    feed = runner.endpoints.mailbox.feed("numbers", Counts())
    feed.put((0, Number(3)))
    wait_until(lambda: "'numbers' ended early: component 'one'" in caplog.text)
    status = runner.status()
    assert (status.errors, status.error, status.error_counts) == (0, "", ())
    assert "LeaseEnded" not in caplog.text


def test_nothing_is_activated_without_a_lease(runner: Runner, lease: LeaseEnd) -> None:
    lease.at = -inf
    runner.aim("active")
    assert runner.life_cycle.wait_state({"inactive"}, LIMIT) == "inactive"
    assert runner.life_cycle.wait_state({"active"}, 0.1) == "inactive"
    assert counter(runner).activations == 0
    lease.at = inf
    assert runner.life_cycle.wait_state({"active"}, LIMIT) == "active"


def test_no_checkpoint_is_saved_after_the_end(tmp_path: Path, lease: LeaseEnd) -> None:
    (tmp_path / "checkpoints").mkdir()
    checkpoints = Checkpoints(tmp_path, "one", 0, 60.0, SystemClock(), lease)
    component = Mock(spec=Counter)

    def snapshot() -> Number:  # a lease may end while this runs
        lease.at = -inf
        return Number(1)

    component.snapshot = snapshot
    with pytest.raises(LeaseEnded, match="component 'one' is inactive"):
        checkpoints.write(component, LatestMessages())
    assert not [each for each in tmp_path.rglob("*") if each.is_file()]


def test_a_source_without_a_lease_sends_no_state(
    runner: Runner, lease: LeaseEnd
) -> None:
    runner.aim("active")
    assert runner.life_cycle.wait_state({"active"}, LIMIT) == "active"
    sender = StateSender(runner, 1, Mock())
    asked = b"".join(frame.segments(REQUEST, (Request.STATE, 1.0), FrameKind.CALL))

    def answer() -> FrameKind:
        return frame.parse(b"".join(sender._serve(frame.parse(asked)))).kind

    assert answer() is FrameKind.RESULT
    lease.at = -inf
    assert answer() is FrameKind.ERROR


class Doubles(Protocol):
    def double(self, value: int) -> int: ...


class Asking(Component):
    said: Published[Number]
    doubles: Required[Doubles]


class Answering(Component):
    doubles: Provided[Doubles]

    def configure(self) -> None:
        self.heard: list[int] = []

    def double(self, value: int) -> int:
        return 2 * value

    @subscribed(keep=10)
    def said(self, message: Number) -> None:
        self.heard.append(message.value)


def joined(pair: Pair, leased: str, lease: LeaseEnd) -> tuple[Asking, Answering]:
    source, target = pair.run("source", Asking), pair.run("target", Answering)
    pair.runners[leased, 0].lease = lease
    pair.join("said")
    pair.join("doubles")
    pair.activate()
    return source, target


@pytest.mark.slow
@apart
def test_a_handler_that_runs_when_the_lease_ends_may_not_publish_or_call(
    pair: Pair, lease: LeaseEnd
) -> None:
    source, target = joined(pair, "source", lease)
    assert source.doubles.double(2) == 4
    lease.at = -inf
    attempts: tuple[Callable[[], object], ...] = (
        lambda: source.doubles.double(2),
        lambda: source.said.publish(Number(1)),
    )
    for act in attempts:
        with pytest.raises(Unavailable, match="component 'source' is inactive: the l"):
            act()
    lease.at = inf
    source.said.publish(Number(2))
    wait_until(lambda: target.heard)
    assert target.heard == [2]


@pytest.mark.slow
@apart
def test_callers_of_a_component_without_a_lease_are_told_why(
    pair: Pair, lease: LeaseEnd
) -> None:
    source, _ = joined(pair, "target", lease)
    lease.at = -inf
    with pytest.raises(Unavailable, match="component 'target' is inactive: the lease"):
        source.doubles.double(2)
    lease.at = inf
    assert source.doubles.double(2) == 4


@pytest.mark.slow
@pytest.mark.parametrize("pair", ["local"], indirect=True)
def test_a_component_that_may_not_say_farewell_keeps_its_state(
    pair: Pair, lease: LeaseEnd
) -> None:
    source = pair.run("source", Counter)
    runner = pair.runners["source", 0]
    runner.lease = lease
    pair.run("target", Counter)
    pair.join("said", "numbers")
    pair.activate()
    lease.at = -inf
    runner.aim("inactive")
    assert runner.life_cycle.wait_state({"inactive", "failed"}, LIMIT) == "inactive"
    lease.at = inf
    runner.aim("active")
    assert runner.life_cycle.wait_state({"active"}, LIMIT) == "active"
    assert source.activations == 2


@pytest.mark.slow
def test_a_command_stands_still_without_a_lease(
    tmp_path: Path, lease: LeaseEnd
) -> None:
    argv = ("/bin/sh", "-c", f"while :; do echo >> {tmp_path}/turns; sleep 0.01; done")
    spec = ComponentSpec(name="one", goal="active", command=argv, leased=True)
    runner = runner_of(spec, tmp_path)
    runner.lease = lease
    runner.aim("active")
    turns = tmp_path / "turns"

    def size() -> int:
        return turns.stat().st_size if turns.exists() else 0

    def wait_more() -> None:
        before = size()
        wait_until(lambda: size() > before + 3)

    wait_more()
    lease.at = -inf
    freeze_fenced([runner])
    threading.Event().wait(0.05)  # a turn that had begun
    before = size()
    due = time.monotonic() + 0.3
    wait_until(lambda: time.monotonic() > due)
    assert size() == before
    lease.at = inf
    freeze_fenced([runner])
    wait_more()
    lease.at = -inf
    freeze_fenced([runner])
    runner.aim("finalized")  # it is woken to end
    reach(runner, "finalized")
