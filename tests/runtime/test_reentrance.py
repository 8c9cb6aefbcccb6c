"""Chains that cross in opposite directions end, over every kind of connector."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Protocol

import pytest

from poise import Component, Provided, Required
from poise.errors import Timeout
from poise.runtime.execution.exclusion import new_chain
from poise.runtime.hosting.runner import Runner
from tests.waiting import LIMIT

from .conftest import Pair, every_kind

pytestmark = pytest.mark.slow


class Asks(Protocol):
    def ask(self, left: int) -> int: ...


class Holding(Component):
    """Calls the other, which calls back, until nothing is left."""

    out: Required[Asks]
    into: Provided[Asks]

    def configure(self) -> None:
        self.inside = self.most = 0

    def ask(self, left: int) -> int:
        self.inside += 1
        self.most = max(self.most, self.inside)
        self.inside -= 1
        return 0 if not left else 1 + self.out.ask(left - 1)


class Letting(Holding):
    reentrant = True


@contextmanager
def crossing(pair: Pair, target: type[Holding], limit: float) -> Iterator[list[Runner]]:
    pair.run("source", Letting if target is Letting else Holding)
    pair.run("target", target)
    pair.join("out", "into", limit=limit)
    pair.join_back("out", "into")
    pair.activate()
    yield [pair.runners["source", 0], pair.runners["target", 0]]


def begin(runner: Runner, both: threading.Barrier) -> int:
    """Begin a chain that calls the other once both have begun."""
    runner.exclusion.enter(new_chain(), LIMIT)
    try:
        both.wait(LIMIT)
        assert isinstance(runner.component, Holding)
        return runner.component.out.ask(4)
    finally:
        runner.exclusion.leave()


def cross(runners: list[Runner]) -> list[int]:
    both = threading.Barrier(len(runners))
    with ThreadPoolExecutor() as pool:
        results = [pool.submit(begin, runner, both) for runner in runners]
        return [result.result(LIMIT) for result in results]


class LettingTarget(Holding):
    reentrant = True


@every_kind
@pytest.mark.parametrize("target", [Letting, LettingTarget])
def test_chains_that_cross_end(pair: Pair, target: type[Holding]) -> None:
    """Both let others in, or one of them."""
    with crossing(pair, target, LIMIT) as runners:
        for _ in range(20):
            assert cross(runners) == [4, 4]
        for runner in runners:
            assert isinstance(runner.component, Holding)
            assert runner.component.most == 1


@every_kind
def test_chains_that_cross_end_at_their_limit_when_none_lets_others_in(
    pair: Pair,
) -> None:
    with crossing(pair, Holding, 0.05) as runners, pytest.raises(Timeout):
        cross(runners)


@every_kind
def test_a_component_comes_to_rest_between_chains_that_cross(pair: Pair) -> None:
    """Whoever waits for the rest keeps nobody out for whom a chain waits."""
    with crossing(pair, Letting, LIMIT) as runners, ThreadPoolExecutor() as pool:
        for runner in runners * 5:
            runner.gate.allow_pause()
            both = threading.Barrier(2)
            chains = [pool.submit(begin, each, both) for each in runners]
            rest = pool.submit(runner.gate.pause_for_migration, LIMIT)
            rest.result(LIMIT)
            runner.aim("active")
            assert [chain.result(LIMIT) for chain in chains] == [4, 4]
