"""A direct call means what a call over a wire means, and counts itself."""

from __future__ import annotations

import gc
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NoReturn, Protocol

import pytest

from poise.errors import CalleeError, Timeout
from poise.runtime import _calls
from poise.runtime.connectors.interface import as_declared, methods
from poise.runtime.connectors.route import direct_call
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.exclusion import (
    Exclusion,
    Redirected,
    join_chain,
    new_chain,
)
from tests.runtime import reference

LONG = 20.0


class Callee:
    """Has methods that go well, wrong, and on and on."""

    def __init__(self) -> None:
        self.proxy: Any = None

    def add(self, one: int, other: int = 1) -> int:
        return one + other

    def fail(self) -> None:
        raise ValueError("no such wall")

    def stop(self) -> None:
        raise KeyboardInterrupt

    def wait(self, event: threading.Event) -> None:
        event.wait(LONG)

    def again(self, depth: int) -> int:
        """Call itself through its connector."""
        return 0 if depth == 0 else 1 + int(self.proxy(depth - 1))


def translate(error: Exception) -> NoReturn:
    raise CalleeError(type(error).__qualname__, str(error)) from error


@pytest.fixture
def exclusion() -> Exclusion:
    made = Exclusion("callee")
    made.resume()
    return made


@pytest.fixture
def counts() -> Counts:
    return Counts()


def test_calls_with_positions_and_names(exclusion: Exclusion, counts: Counts) -> None:
    call = direct_call(Callee().add, exclusion, 1.0, counts)
    assert call(1) == 2
    assert call(1, 2) == 3
    assert call(one=3, other=4) == 7
    assert (counts.calls, counts.errors) == (3, 0)
    assert counts.delay.summary().count == 3


class Adding(Protocol):
    def add(self, first: int, second: int = 5) -> int: ...


def test_takes_names_and_defaults_of_the_interface() -> None:
    (method,) = methods(Adding).values()
    call = as_declared(Callee().add, method)
    assert (call(1), call(first=1), call(1, second=2), call(1, 2)) == (6, 6, 3, 3)


def test_is_the_method_itself_where_that_is_declared_alike() -> None:
    class Same:
        def add(self, first: int, second: int = 5) -> int:
            return first + second

    (method,) = methods(Adding).values()
    same = Same().add
    assert as_declared(same, method) is same


def test_wraps_what_the_callee_raised(exclusion: Exclusion, counts: Counts) -> None:
    call = direct_call(Callee().fail, exclusion, 1.0, counts)
    with pytest.raises(CalleeError, match="ValueError: no such wall") as caught:
        call()
    assert isinstance(caught.value.__cause__, ValueError)
    assert "in fail" in caught.value.traceback
    assert (counts.calls, counts.errors) == (1, 1)
    exclusion.enter(new_chain(), 0)  # it was given back


def test_wraps_a_wrong_argument_too(exclusion: Exclusion, counts: Counts) -> None:
    call = direct_call(Callee().add, exclusion, 1.0, counts)
    with pytest.raises(CalleeError, match="TypeError"):
        call()


def test_lets_an_interrupt_through(exclusion: Exclusion, counts: Counts) -> None:
    call = direct_call(Callee().stop, exclusion, 1.0, counts)
    with pytest.raises(KeyboardInterrupt):
        call()
    exclusion.enter(new_chain(), 0)


def test_gives_up_when_the_callee_is_busy(exclusion: Exclusion, counts: Counts) -> None:
    exclusion.enter(1, 0)
    join_chain(2)
    with pytest.raises(Timeout, match=r"'callee' was busy for 0\.01 s"):
        direct_call(Callee().add, exclusion, 0.01, counts)(1)
    assert (counts.calls, counts.errors) == (1, 1)


def test_gives_up_a_result_that_comes_too_late(
    exclusion: Exclusion, counts: Counts
) -> None:
    def slow() -> None:
        until = time.monotonic() + 0.002
        while time.monotonic() < until:
            pass

    with pytest.raises(Timeout, match=r"slow took \d+\.\d+ s, limit 0\.001 s"):
        direct_call(slow, exclusion, 0.001, counts)()
    assert (counts.calls, counts.errors) == (1, 1)


def test_lets_a_chain_come_back(exclusion: Exclusion, counts: Counts) -> None:
    callee = Callee()
    callee.proxy = direct_call(callee.again, exclusion, 1.0, counts)
    assert callee.proxy(20) == 20
    assert counts.calls == 21


def test_sends_a_call_on_when_the_callee_has_moved(
    exclusion: Exclusion, counts: Counts
) -> None:
    exclusion.redirect()
    call = direct_call(
        Callee().add, exclusion, 1.0, counts, lambda one, other=1: ("there", one, other)
    )
    assert call(1, other=5) == ("there", 1, 5)
    assert counts.calls == 0


def test_sends_on_a_call_that_waits_while_the_callee_moves(
    exclusion: Exclusion, counts: Counts
) -> None:
    exclusion.enter(1, 0)
    call = direct_call(Callee().add, exclusion, LONG, counts, lambda _one: "there")
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(call, 1)
        exclusion.redirect()
        assert answer.result(LONG) == "there"


def test_says_that_the_callee_moved_when_nobody_sends_on(
    exclusion: Exclusion, counts: Counts
) -> None:
    exclusion.redirect()
    with pytest.raises(Redirected):
        direct_call(Callee().add, exclusion, 1.0, counts)(1)


def test_refuses_what_is_no_exclusion(counts: Counts) -> None:
    with pytest.raises(TypeError, match="incompatible function arguments"):
        _calls.direct_call(len, object(), 1.0, counts, translate)  # type: ignore[arg-type]


def test_is_freed_with_the_component_that_it_calls(
    exclusion: Exclusion, counts: Counts
) -> None:
    callee = Callee()
    callee.proxy = direct_call(callee.again, exclusion, 1.0, counts)
    gone = weakref.ref(callee)
    del callee
    gc.collect()
    assert gone() is None


def test_counts_every_call_of_many_threads() -> None:
    """Native and readable calls, re-entered and failing, all agree in their counts."""
    native, readable = Counts(), reference.Counts()
    for call, counts in (
        (hammered(native, direct_call), native),
        (hammered(readable, reference_call), readable),
    ):
        with ThreadPoolExecutor(6) as pool:
            results = [pool.submit(hammer, call) for _ in range(6)]
            failures = sum(result.result(LONG) for result in results)
        # each of 6 x 1000 calls comes back once, and each hundredth fails
        assert failures == 6 * 10
        assert counts.calls == 6 * 1000 * 2
        # the inner call fails, and so does the outer one that it fails in
        assert counts.errors == 6 * 10 * 2
        assert counts.delay.summary().count == counts.calls


def hammered(counts: Any, make: Any) -> Any:
    """Return a call to a callee that calls itself once, and fails now and then."""
    exclusion = Exclusion("callee")
    exclusion.resume()

    def method(number: int, depth: int) -> int:
        if depth:
            return int(call(number, 0))
        if number % 100 == 0:
            raise ValueError(number)
        return number

    call = make(method, exclusion, LONG, counts)
    return call


def reference_call(method: Any, exclusion: Any, limit: float, counts: Any) -> Any:
    return reference.direct_call(method, exclusion, limit, counts, translate)


def hammer(call: Any) -> int:
    """Make a thousand calls, each a chain of its own; return how many failed."""
    failures = 0
    for number in range(1000):
        join_chain(0)
        try:
            assert call(number, 1) == number
        except CalleeError:
            failures += 1
    return failures


def busy(seconds: float) -> None:
    """Use CPU for about `seconds` [s]."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_knows_the_cpu_time_of_long_calls(exclusion: Exclusion, counts: Counts) -> None:
    call = direct_call(busy, exclusion, LONG, counts)
    began = time.thread_time()
    for _ in range(20):
        call(0.002)
    used = time.thread_time() - began
    assert counts.cpu == pytest.approx(used, rel=0.1)


def test_knows_about_the_cpu_time_of_bursts(
    exclusion: Exclusion, counts: Counts
) -> None:
    call = direct_call(sum, exclusion, LONG, counts)
    numbers = list(range(100))
    began, wall_began = time.thread_time(), time.monotonic()
    for _ in range(200_000):
        call(numbers)
    used, wall = time.thread_time() - began, time.monotonic() - wall_began
    # the loop and the reading of clocks, which is slow on a busy machine, are the
    # caller's own; one call in many is measured, and what a busy machine takes from the
    # others counts as theirs
    assert 0.05 * used < counts.cpu < wall


@pytest.mark.slow
def test_does_not_take_waiting_for_cpu_time(
    exclusion: Exclusion, counts: Counts
) -> None:
    direct_call(time.sleep, exclusion, LONG, counts)(0.05)
    assert counts.cpu < 0.02
