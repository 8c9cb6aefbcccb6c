"""One thread at a time runs a chain in a process, and nobody waits for ever."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from poise.errors import Timeout
from poise.runtime.connectors import visits
from poise.runtime.connectors.visits import away, visit
from poise.runtime.turn import new_chain

LONG = 20.0
SHORT = 0.02


@pytest.fixture
def others() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor() as pool:
        yield pool


def comes_in(chain: int, limit: float) -> bool:
    try:
        with visit(chain, limit):
            return True
    except Timeout:
        return False


def test_a_chain_may_come_back_while_its_thread_waits(
    others: ThreadPoolExecutor,
) -> None:
    chain = new_chain()
    with visit(chain, LONG):
        assert not others.submit(comes_in, chain, SHORT).result(LONG)
        with away(chain, LONG, "a-b"):
            assert others.submit(comes_in, chain, LONG).result(LONG)
        assert not others.submit(comes_in, chain, SHORT).result(LONG)
    assert others.submit(comes_in, chain, LONG).result(LONG)


def test_what_comes_back_late_does_not_come_in_where_the_chain_began(
    others: ThreadPoolExecutor,
) -> None:
    chain = new_chain()
    for _ in range(2):
        with away(chain, LONG, "a-b"):
            assert others.submit(comes_in, chain, LONG).result(LONG)
        assert not others.submit(comes_in, chain, SHORT).result(LONG)


def test_who_was_called_back_and_does_not_end_is_named(
    others: ThreadPoolExecutor,
) -> None:
    chain = new_chain()
    inside, go_on = threading.Event(), threading.Event()

    def stay() -> None:
        with visit(chain, LONG):
            inside.set()
            assert go_on.wait(LONG)

    with (  # noqa: PT012, the call ends while somebody is inside
        pytest.raises(Timeout, match=r"connector a-b: .* still runs after 0.02 s"),
        away(chain, SHORT, "a-b"),
    ):
        staying = others.submit(stay)
        assert inside.wait(LONG)
    go_on.set()
    staying.result(LONG)
    with away(chain, LONG, "a-b"):  # and from now on all is as before
        assert others.submit(comes_in, chain, LONG).result(LONG)
    assert not others.submit(comes_in, chain, SHORT).result(LONG)


def test_nothing_is_left_of_chains_that_are_over() -> None:
    def call(count: int) -> None:
        for _ in range(count):
            chain = new_chain()
            with away(chain, LONG, "a-b"):
                pass

    gc.collect()
    before = len(visits._visits)
    with ThreadPoolExecutor(1) as pool:
        pool.submit(call, 100).result(LONG)
    gc.collect()
    assert len(visits._visits) <= before
