"""Orders to a container: what is too late for the move that it was given in."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import Mock

import pytest

from poise import Component
from poise.clock import SystemClock
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration.executor import MigrationExecutor
from poise.wire.records.deployment import ComponentSpec
from poise.wire.records.migration import (
    Done,
    Failed,
    Give,
    Offer,
    Open,
    Order,
    Rest,
    Step,
)
from tests.waiting import LIMIT


class Nothing(Component):
    """Does nothing."""


@pytest.fixture
def runner() -> Iterator[Runner]:
    spec = ComponentSpec(name="one", goal="inactive")
    runner = Runner(spec, Nothing, SystemClock(), lambda: None)
    runner.start()
    runner.aim("active")
    assert runner.wait_state({"active", "failed"}, LIMIT) == "active"
    runner.stay()
    yield runner
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)


@pytest.fixture
def steps(runner: Runner) -> MigrationExecutor:
    return MigrationExecutor({("one", 0): runner}, Mock(), Mock())


def order(*steps: Step) -> Order:
    return Order(1, "container", steps, LIMIT)


def is_at_work(runner: Runner) -> bool:
    """Return whether it can be entered."""
    runner.exclusion.enter(7, LIMIT)
    runner.exclusion.leave()
    return True


def test_orders_of_the_move_before_are_not_taken(
    steps: MigrationExecutor, runner: Runner
) -> None:
    late = steps.hear(order(Rest("one", 0, mark=1)))
    steps.note_deployment()  # it led back, and the next move begins
    runner.stay()
    assert isinstance(steps.hear(order(Offer("one", 0, number=2)))(), Done)
    outcome = late()
    assert isinstance(outcome, Failed)
    assert outcome.reason == "Rest is late: a deployment came before it"
    assert is_at_work(runner)


def test_what_gave_its_state_is_not_opened_by_the_move_before(
    steps: MigrationExecutor, runner: Runner
) -> None:
    late = steps.hear(order(Open("one", 0)))
    steps.note_deployment()
    runner.stay()
    moving = order(Offer("one", 0, number=2), Rest("one", 0, mark=2), Give("one", 0))
    assert isinstance(steps.hear(moving)(), Done)
    assert isinstance(late(), Failed)
    with runner.at_rest():  # it is, still
        pass
