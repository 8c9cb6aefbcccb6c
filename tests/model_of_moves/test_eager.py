"""Eager steps leave out no end of a move, whatever happens."""

from __future__ import annotations

import pytest

from tests.model_of_moves.checker import crossings
from tests.model_of_moves.eager import Eager
from tests.model_of_moves.protocol import Protocol, initial
from tests.model_of_moves.test_protocol import check
from tests.model_of_moves.world import Bounds, visible

pytestmark = [
    pytest.mark.exhaustive,
    pytest.mark.slow,
    pytest.mark.usefixtures("keeps_garbage"),
]

SMALL = [
    Bounds(messages=1, gives_up=1),
    Bounds(messages=1, callers="c"),
    Bounds(messages=0, callers="r", gives_up=1),
    Bounds(messages=1, kills=1, killed="S"),
    Bounds(messages=1, kills=1, killed="on", speaks=True),
    Bounds(messages=0, callers="r", kills=1, killed="on"),
    Bounds(messages=0, movers=2, callers="u"),
    Bounds(messages=0, movers=2, callers="d"),
]


@pytest.mark.parametrize("bounds", SMALL, ids=str)
def test_no_other_step_is_lost_by_an_eager_one(bounds: Bounds) -> None:
    steps = Protocol(bounds).successors
    assert list(crossings(initial(bounds), steps, Eager(bounds), visible)) == []


@pytest.mark.parametrize("bounds", SMALL, ids=str)
def test_the_same_ends_are_reached_over_fewer_states(bounds: Bounds) -> None:
    all_, few = check(bounds, is_full=True), check(bounds)
    assert few.last == all_.last
    assert few.num_states < all_.num_states


def test_a_step_that_is_not_eager_is_seen() -> None:
    bounds = Bounds(messages=1, gives_up=1)
    steps = Protocol(bounds).successors

    def is_eager(_: object, name: str) -> bool:
        return name == "buffer at source"

    found = [*crossings(initial(bounds), steps, is_eager, visible)]
    assert any(each.startswith("buffer at source and publish") for each in found)
