"""A call's limit holds for all that is done in it, over every kind of connector."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import pytest

from poise import Component, Provided, Required, every, time_left, within
from poise.errors import Timeout, UsageError
from poise.runtime import _calls
from poise.runtime.connectors.interface import methods
from poise.runtime.execution.exclusion import new_chain
from poise.testing import Bench
from poise.wire import frame
from poise.wire.address import Address
from poise.wire.connections.connection import Connection
from poise.wire.connections.opening import CALLS, Opening
from poise.wire.frame import FrameKind
from poise.wire.records.deployment_records import ConnectorSpec
from tests.runtime.conftest import Pair, every_kind
from tests.waiting import LIMIT, wait_until

pytestmark = pytest.mark.slow

SHORT = 0.05


class Work(Protocol):
    def left(self, depth: int) -> list[float]: ...
    def wait_until_over(self) -> float: ...
    def count(self) -> int: ...


class Worker(Component):
    """Says how much time is left to it, and to whom it calls."""

    out: Required[Work]
    into: Provided[Work]

    def configure(self) -> None:
        self.num_calls = 0
        self.began = threading.Event()
        self.ended = threading.Event()

    def left(self, depth: int) -> list[float]:
        return [time_left(), *(self.out.left(depth - 1) if depth else [])]

    def wait_until_over(self) -> float:
        self.began.set()
        began = time.monotonic()
        wait_until(lambda: not time_left())
        time.sleep(10 * SHORT)  # an answer that comes sooner may still be in time
        self.ended.set()
        return time.monotonic() - began

    def count(self) -> int:
        self.num_calls += 1
        return self.num_calls


@contextmanager
def joined(
    pair: Pair, limit: float = LIMIT, limit_back: float = LIMIT
) -> Iterator[tuple[Worker, Worker, ConnectorSpec]]:
    """Give a source and a target that call each other, and the connector there."""
    source, target = pair.run("source", Worker), pair.run("target", Worker)
    spec = pair.join("out", "into", limit=limit)
    pair.join_back("out", "into", limit=limit_back)
    pair.activate()
    yield source, target, spec


@every_kind
def test_a_callee_knows_how_long_its_caller_waits(pair: Pair) -> None:
    with joined(pair, limit=5.0) as (source, _, _):
        assert time_left() == math.inf
        (left,) = source.out.left(0)
        assert 1.0 < left <= 5.0
        assert time_left() == math.inf


@every_kind
def test_a_call_in_a_call_has_what_is_left_of_that(pair: Pair) -> None:
    with joined(pair, limit=5.0, limit_back=LIMIT) as (source, _, _):
        there, back, there_again = source.out.left(2)
    assert 5.0 >= there > back > there_again > 1.0


@every_kind
def test_a_call_in_a_call_keeps_a_shorter_limit_of_its_own(pair: Pair) -> None:
    with joined(pair, limit=LIMIT, limit_back=5.0) as (source, _, _):
        there, back = source.out.left(1)
    assert there > 5.0 >= back


@every_kind
@pytest.mark.parametrize("limit", [1e12, 1e300, math.inf])
def test_a_limit_may_be_of_any_length(pair: Pair, limit: float) -> None:
    with joined(pair, limit=limit) as (source, _, _):
        (left,) = source.out.left(0)
        assert left > 1e8


@every_kind
def test_a_block_gives_its_calls_up(pair: Pair) -> None:
    with joined(pair) as (source, target, _):
        began = time.monotonic()
        with within(LIMIT), within(SHORT), within(LIMIT), pytest.raises(Timeout):
            source.out.wait_until_over()
        assert time.monotonic() - began < LIMIT / 2
        # on a busy machine it may come too late to begin
        wait_until(lambda: target.ended.is_set() or not target.began.is_set())
        assert source.out.count() == 1  # it works again, without a limit
        assert time_left() == math.inf


@every_kind
@pytest.mark.parametrize("seconds", [0.0, -1.0, -math.inf])
def test_without_time_no_call_is_made(pair: Pair, seconds: float) -> None:
    with joined(pair) as (source, target, _):
        with within(seconds), pytest.raises(Timeout, match="no time is left"):
            source.out.count()
        assert target.num_calls == 0
        sides = {id(side): side for side in pair.sides.values()}.values()
        assert sum(end.errors for side in sides for end in side.status()) == 1


@every_kind
def test_who_waits_for_a_busy_callee_waits_no_longer_than_that(pair: Pair) -> None:
    with joined(pair) as (source, target, _):
        exclusion = pair.runners["target", 0].exclusion
        exclusion.enter(new_chain(), LIMIT)
        _calls.join_chain(0)
        with within(SHORT), pytest.raises(Timeout):
            source.out.count()
        exclusion.leave()
        assert source.out.count() == target.num_calls == 1


def test_a_block_wants_a_number() -> None:
    with pytest.raises(UsageError, match="within"), within(math.nan):
        pass


def test_a_block_is_over_when_its_code_raises() -> None:
    with pytest.raises(KeyError), within(1.0):
        raise KeyError
    assert time_left() == math.inf


def test_a_block_is_of_its_thread() -> None:
    with ThreadPoolExecutor() as pool, within(1.0):
        assert pool.submit(time_left).result(LIMIT) == math.inf
        assert 0.0 < time_left() <= 1.0


@pytest.mark.parametrize("seconds", [1e9, 1e30, math.inf])
def test_a_block_without_an_end_is_no_limit(seconds: float) -> None:
    with within(seconds):
        assert time_left() == math.inf


class Ticking(Component):
    def configure(self) -> None:
        self.left: list[float] = []

    @every(1.0)
    def tick(self) -> None:
        self.left.append(time_left())


def test_nobody_waits_for_a_timer() -> None:
    bench = Bench(Ticking)
    bench.advance(2.0)
    assert bench.component.left == [math.inf, math.inf]


wired = pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)


def begin(pair: Pair, spec: ConnectorSpec, method: str) -> Connection:
    """Begin a call as a container that will be killed; return its link."""
    address, folder = Address.parse(spec.address), Path(pair.folder)
    opening = Opening(spec.key, address, folder)
    assert opening.go_on(CALLS, time.monotonic() + LIMIT)
    (asked,) = (m for m in methods(Work).values() if m.name == method)
    pieces = frame.segments(
        asked.arguments, (), FrameKind.CALL, tag=asked.tag, chain=new_chain()
    )
    _calls.join_chain(0)
    opening.connection.send(pieces, time.monotonic() + LIMIT)
    return opening.connection


@wired
def test_a_callee_knows_that_its_caller_was_killed(pair: Pair) -> None:
    with joined(pair) as (_, target, spec):
        connection = begin(pair, spec, "wait_until_over")
        assert target.began.wait(LIMIT)
        assert not target.ended.is_set()
        connection.close()
        assert target.ended.wait(LIMIT / 2)


@wired
def test_a_call_that_waits_is_not_run_when_its_caller_was_killed(pair: Pair) -> None:
    """Nobody tells when it has begun to wait; when it comes later, it is run."""
    with joined(pair) as (source, target, spec):
        exclusion = pair.runners["target", 0].exclusion
        patience = 0.02
        while patience < LIMIT:
            before = target.num_calls
            exclusion.enter(new_chain(), LIMIT)
            _calls.join_chain(0)
            begin(pair, spec, "count").close()
            time.sleep(patience)
            exclusion.leave()
            time.sleep(patience)
            if source.out.count() == before + 1:
                return
            patience *= 2
        pytest.fail("it was always run")
