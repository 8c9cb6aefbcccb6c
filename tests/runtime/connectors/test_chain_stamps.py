"""Stamps of chains go with messages, calls and answers over every kind of connector."""

from __future__ import annotations

import threading
from typing import Protocol

import numpy as np
import pytest
from numpy.typing import NDArray

from poise import Component, Message, Provided, Published, Required, oneway, subscribed
from poise.clock import Elapsed
from poise.runtime.execution.data_age import SentChains
from poise.wire.records.deployment_records import ChainPart
from poise.wire.records.status_records import ChainStatus
from tests.runtime.conftest import Pair, every_kind
from tests.waiting import LIMIT, wait_until

pytestmark = pytest.mark.slow

FIRST = ChainPart(name="c", is_first=True)
LAST = ChainPart(name="c", deadline=4.0)


class Scan(Message):
    ranges: NDArray[np.float32]


class Scans(Protocol):
    def take(self, scan: Scan, times: int = 2) -> float: ...

    def give(self) -> Scan: ...

    @oneway
    def note(self, scan: Scan) -> None: ...


class Target(Component):
    scans: Provided[Scans]

    def configure(self) -> None:
        self.came = threading.Event()

    def take(self, scan: Scan, times: int = 2) -> float:
        return times * float(scan.ranges.sum())

    def give(self) -> Scan:
        return SCAN

    def note(self, scan: Scan) -> None:
        assert scan.ranges.sum() == 3
        self.came.set()

    @subscribed(block=4)
    def scan(self, message: Scan) -> None:
        self.note(message)


class Source(Component):
    scans: Required[Scans]
    scan: Published[Scan]


SCAN = Scan(np.ones(3, np.float32))


def age_of(pair: Pair, component: str) -> ChainStatus:
    """Return what a component counted of the chain, once it has used data."""

    def status() -> ChainStatus:
        return pair.runners[component, 0].ages.status()[0]

    wait_until(lambda: status().age.count > 0)
    return status()


def started(pair: Pair, port: str, *, back: bool = False) -> tuple[Source, Target]:
    first, last = ("target", "source") if back else ("source", "target")
    parts = {first: FIRST, last: LAST}
    target = pair.run("target", Target, parts["target"])
    source = pair.run("source", Source, parts["source"])
    pair.join(port)
    if back:
        pair.let_chains_pass(answers=("c",))
    else:
        pair.let_chains_pass(carries=("c",))
    pair.clocks |= {"source": Elapsed(0.0), "target": Elapsed(0.0)}
    pair.activate()
    return source, target


@every_kind
def test_a_message_carries_its_stamp(pair: Pair) -> None:
    source, target = started(pair, "scan")
    source.scan.publish(SCAN)
    assert target.came.wait(LIMIT)
    assert 0 < age_of(pair, "target").age.maximum < LIMIT


@every_kind
def test_a_call_and_a_oneway_call_carry_their_stamps(pair: Pair) -> None:
    source, target = started(pair, "scans")
    assert source.scans.take(SCAN, times=3) == 9
    assert age_of(pair, "target").age.count == 1
    source.scans.note(SCAN)
    assert target.came.wait(LIMIT)
    wait_until(lambda: age_of(pair, "target").age.count > 1)


@every_kind
def test_an_answer_carries_its_stamp(pair: Pair) -> None:
    source, _ = started(pair, "scans", back=True)
    runner = pair.runners["source", 0]
    runner.ages.run(source.scans.give, [])
    assert age_of(pair, "source").age.count == 1


@pytest.mark.parametrize("pair", ["direct"], indirect=True)
def test_an_error_names_the_method_that_was_called(pair: Pair) -> None:
    _, target = started(pair, "scans")
    ages = pair.runners["target", 0].ages
    method = SentChains(ages, ("c",), ()).direct(target.take, ages)
    assert method.__qualname__ == "Target.take"


@pytest.mark.parametrize("pair", ["remote"], indirect=True)
def test_an_age_is_told_by_ones_own_clock(pair: Pair) -> None:
    """The target believes that the source's clock is 5 s ahead."""
    source, target = started(pair, "scan")
    pair.clocks["source"] = Elapsed(5.0)
    for end in pair.sides["target"].open_connectors():
        end.remote_clock.update()
    source.scan.publish(SCAN)
    assert target.came.wait(LIMIT)
    found = age_of(pair, "target")
    assert 5.0 < found.age.maximum < 5.0 + LIMIT
    assert found.missed == 1
