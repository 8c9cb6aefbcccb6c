"""Calls that are started: at once, answered in turn, waited for by a move."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, ThreadPoolExecutor
from functools import partial
from typing import cast

import pytest

import poise
from poise.clock import SystemClock
from poise.errors import RunError, Timeout
from poise.runtime.component import started_calls
from poise.runtime.component.component import Context, create
from poise.runtime.component.started_calls import (
    MOST_OPEN,
    ImmediateCalls,
    StartedCall,
    StartedCalls,
)
from poise.runtime.connectors.endpoints import ComponentEndpoints
from poise.runtime.execution.exclusion import Exclusion
from poise.runtime.hosting.life_cycle import ExecutionGate
from tests.waiting import LONG, wait_until


class Component:
    """Something that takes answers when the test says so."""

    def __init__(self) -> None:
        self.turns: deque[Callable[[], object]] = deque()
        self.calls = StartedCalls("asker", self.turns.append)

    def take_turns(self) -> None:
        while self.turns:
            self.turns.popleft()()


@pytest.fixture
def component() -> Component:
    return Component()


def test_two_are_asked_at_once(component: Component) -> None:
    both = threading.Barrier(2)
    first = component.calls.start(both.wait, LONG)
    second = component.calls.start(both.wait, LONG)
    assert {first.result(), second.result()} == {0, 1}
    assert component.calls.wait(time.monotonic() + LONG)


def test_an_answer_is_taken_in_the_components_turn(component: Component) -> None:
    taken: list[int] = []

    def take(call: StartedCall[int]) -> None:
        taken.append(call.result())

    component.calls.start(lambda: 7).then(take)
    wait_until(lambda: component.turns)
    assert (taken, component.calls.num_open) == ([], 1)
    component.take_turns()
    assert (taken, component.calls.num_open) == ([7], 0)


def test_what_was_raised_comes_with_the_answer(component: Component) -> None:
    def fail() -> None:
        raise Timeout("too late")

    call = component.calls.start(fail)
    with pytest.raises(Timeout, match="too late"):
        call.result()


def test_what_was_cancelled_is_not_taken(component: Component) -> None:
    goes_on, taken = threading.Event(), list[object]()
    call = component.calls.start(goes_on.wait, LONG)
    call.then(taken.append)
    assert call.cancel()
    assert call.done()
    goes_on.set()
    component.take_turns()
    assert taken == []
    assert component.calls.wait(time.monotonic() + LONG)
    with pytest.raises(CancelledError):
        call.result()


def test_the_limit_of_its_starter_holds(component: Component) -> None:
    with poise.within(100.0):
        left = component.calls.start(poise.time_left).result()
    assert 50.0 < left <= 100.0


def test_too_many_are_refused_and_none_waits_for_ever(component: Component) -> None:
    goes_on = threading.Event()
    calls = [component.calls.start(goes_on.wait, LONG) for _ in range(MOST_OPEN)]
    with pytest.raises(RunError, match=f"{MOST_OPEN} calls of 'asker' wait"):
        component.calls.start(int)
    goes_on.set()
    assert all(call.result() for call in calls)


def test_each_may_wait_for_a_call_that_its_callee_starts(component: Component) -> None:
    callee = StartedCalls("callee", lambda _: None)
    asked = threading.Barrier(MOST_OPEN)

    def ask() -> int:
        asked.wait(LONG)
        return callee.start(lambda: 7).result()

    calls = [component.calls.start(ask) for _ in range(MOST_OPEN)]
    assert {call.result() for call in calls} == {7}


def test_one_that_finds_no_thread_is_not_waited_for(
    component: Component, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(started_calls, "_threads", partial(ThreadPoolExecutor, 1))
    with monkeypatch.context() as patching:
        patching.setattr(threading.Thread, "start", refuse)
        with pytest.raises(RunError, match="no call of 'asker' is started: can't"):
            component.calls.start(int)
    assert component.calls.wait(time.monotonic())


def test_a_pause_waits_for_answers_or_says_that_it_does(component: Component) -> None:
    exclusion, goes_on = Exclusion("asker"), threading.Event()
    nothing = cast("ComponentEndpoints", _Nothing())
    gate = ExecutionGate("asker", exclusion, nothing, component.calls, lambda: True)
    gate.resume()
    call = component.calls.start(goes_on.wait, LONG)
    with pytest.raises(Timeout, match="waits for the answers of 1 call that"):
        gate.pause(0.05)
    assert not gate.is_paused
    goes_on.set()
    assert call.result()
    gate.pause(LONG)
    assert gate.is_paused


class _Nothing:
    """Stands for endpoints that nothing goes over."""

    def __init__(self) -> None:
        self.mailbox = self

    def set_unbounded(self, *, unbounded: bool) -> None: ...

    def send_buffered(self) -> None: ...


def test_alone_each_call_is_made_at_once() -> None:
    calls, taken = ImmediateCalls(), list[int]()
    here = calls.start(threading.get_ident)
    here.then(lambda call: taken.append(call.result()))
    assert taken == [threading.get_ident()]
    assert calls.num_open == 0


def test_answers_to_be_taken_are_no_calls(component: Component) -> None:
    for _ in range(MOST_OPEN):
        call = component.calls.start(int)
        call.then(lambda _: None)
        call.result()
    assert component.calls.num_open >= MOST_OPEN  # answers that nobody has taken
    component.calls.start(int).result()


def test_what_it_waits_for_counts_a_call_once(component: Component) -> None:
    """A call whose answer `then` takes was counted twice."""
    release = threading.Event()
    component.calls.start(release.wait).then(StartedCall.result)
    assert str(component.calls) == "the answers of 1 call that it started"
    release.set()
    wait_until(lambda: component.turns)
    assert str(component.calls) == "its turn to take 1 answer"
    component.take_turns()


def test_a_failure_that_nobody_takes_is_logged(
    component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    component.calls.start(lambda: 1 / 0)
    wait_until(lambda: "ZeroDivisionError" in caplog.text)
    assert "a started call failed, and nobody takes its answer" in caplog.text


def test_a_failure_that_is_taken_is_not_logged(
    component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(ZeroDivisionError):
        component.calls.start(lambda: 1 / 0).result()
    assert caplog.text == ""


def test_a_method_of_the_component_itself_is_refused() -> None:
    class Heater(poise.Component):
        def heat(self) -> None: ...

    context = Context(
        name="heater",
        parameters={},
        devices={},
        clock=SystemClock(),
        measure=lambda *_: None,
    )
    heater = create(Heater, context)
    with pytest.raises(poise.UsageError, match="not a method of the component itself"):
        heater.start_call(heater.heat)


def test_what_calls_take_is_counted_also_if_they_fail(component: Component) -> None:
    """On another thread: their component's own has nothing to do with it."""

    def compute() -> None:
        end = time.thread_time() + 0.05
        while time.thread_time() < end:
            pass
        raise Timeout("too late")

    began = time.thread_time()
    with pytest.raises(Timeout, match="too late"):
        component.calls.start(compute).result()
    assert time.thread_time() - began < 0.04
    assert component.calls.counts.cpu == pytest.approx(0.05, rel=0.2)
    assert component.calls.awaited > 0.04
