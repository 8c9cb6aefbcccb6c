"""What a run took by itself, and for how long it waited."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from poise.runtime._calls import direct_call
from poise.runtime.component.started_calls import StartedCalls
from poise.runtime.connectors.route import raise_callee_error
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.exclusion import Exclusion
from poise.runtime.hosting.handler_times import HandlerTimes
from poise.wire.records.status_records import Summary

pytestmark = pytest.mark.slow

CPU, LONG = 0.05, 0.2


def compute(seconds: float = CPU) -> None:
    """Use CPU time [s]."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


@pytest.fixture
def counts() -> Counts:
    return Counts()


@pytest.fixture
def started() -> StartedCalls:
    return StartedCalls("asker", lambda do: do())


@pytest.fixture
def times(counts: Counts, started: StartedCalls) -> HandlerTimes:
    return HandlerTimes(lambda: [counts], started)


def test_sleeping_is_a_wait_and_computing_is_not(times: HandlerTimes) -> None:
    began = times.begin()
    compute()
    time.sleep(LONG)
    times.end("see", began)
    assert times.cpu()["see"].maximum == pytest.approx(CPU, rel=0.2)
    assert times.waits()["see"].maximum > 0.95 * LONG


@pytest.mark.parametrize("answers", [compute, lambda: time.sleep(LONG)])
def test_what_a_direct_call_takes_is_its_callees(
    times: HandlerTimes, counts: Counts, answers: Callable[[], None]
) -> None:
    """Both use one thread."""
    exclusion = Exclusion("callee")
    exclusion.resume()
    call = direct_call(answers, exclusion, 10.0, counts, raise_callee_error, None)
    began = times.begin()
    compute()
    call()
    times.end("ask", began)
    assert times.cpu()["ask"].maximum == pytest.approx(CPU, rel=0.2)
    assert times.waits().get("ask", Summary()).maximum < LONG / 2


def test_what_a_call_over_a_wire_takes_is_no_wait(
    times: HandlerTimes, counts: Counts
) -> None:
    began = times.begin()
    time.sleep(LONG)
    counts.add_call(LONG)
    times.end("ask", began)
    assert times.waits().get("ask", Summary()).maximum < LONG / 2


def test_a_call_counts_from_when_it_is_inside_on_whatever_thread(
    times: HandlerTimes,
) -> None:
    """And not if it raises."""

    def answer(seconds: float) -> float:
        compute()
        time.sleep(seconds)
        return 1 / seconds

    call = times.timing(answer, "a.x-b.y")
    with ThreadPoolExecutor() as others:
        assert others.submit(call, LONG).result() == 1 / LONG
        assert isinstance(others.submit(call, 0.0).exception(), ZeroDivisionError)
    assert times.cpu()["a.x-b.y"].maximum == pytest.approx(CPU, rel=0.2)
    assert times.waits()["a.x-b.y"].maximum == pytest.approx(LONG, rel=0.1)
    assert times.waits()["a.x-b.y"].count == 1


def test_a_call_that_is_started_takes_nothing_of_its_starters_cpu(
    times: HandlerTimes, counts: Counts, started: StartedCalls
) -> None:
    """It runs beside it, and its result is waited for."""
    exclusion = Exclusion("callee")
    exclusion.resume()
    call = direct_call(
        partial(compute, LONG), exclusion, 10.0, counts, raise_callee_error, None
    )
    began = times.begin()
    compute()
    answer = started.start(call)
    time.sleep(LONG / 4)
    beside = time.monotonic() - began.at  # the sleep is longer on a busy machine
    answer.result()
    times.end("ask", began)
    assert times.cpu()["ask"].maximum == pytest.approx(CPU, rel=0.2)
    assert times.waits().get("ask", Summary()).maximum < beside


def test_each_handler_counts_for_itself(times: HandlerTimes) -> None:
    for name in ("see", "see", "tick"):
        times.end(name, times.begin())
    assert {n: s.count for n, s in times.cpu().items()} == {"see": 2, "tick": 1}
