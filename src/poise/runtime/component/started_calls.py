"""Calls that a component starts without waiting: their answers come in its own turn.

A move waits until all have been answered and taken, since no answer could follow.
"""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, partial
from typing import Any, Generic, NoReturn, ParamSpec, TypeVar

from poise.errors import RunError
from poise.runtime import _calls
from poise.runtime._calls import new_chain
from poise.threads import take_poise_name
from poise.units import counted

ANSWER = "answer"
"""What takes an answer in a turn of its own is called so."""
MOST_OPEN = 64
"""The most unanswered calls of one component. Each has a thread: one that waited for a
thread might be what those on all threads wait for."""
P = ParamSpec("P")
R = TypeVar("R")
Turn = Callable[[Callable[[], object]], object]
"""Lets a component run something as soon as nothing else of it runs."""


class StartedCall(Generic[R]):
    """A call that was started. Any thread may use it."""

    def __init__(self, future: Future[R], calls: StartedCalls) -> None:
        self._future = future
        self._calls = calls
        self._is_awaited = False

    def __del__(self) -> None:
        if not self._is_awaited:  # a failure would go unnoticed
            self._future.add_done_callback(self._calls.note_unawaited)

    def done(self) -> bool:
        """Return whether it was answered, failed, or was cancelled."""
        return self._future.done()

    def result(self) -> R:
        """Wait for the result, within the connector's limit, and return it.

        Raises
        ------
        CallError
            As a call that is waited for: `Unavailable`, `Timeout`, `CalleeError`.
        concurrent.futures.CancelledError
            It was cancelled.
        """
        self._is_awaited = True
        began = time.monotonic()
        try:
            return self._future.result()
        finally:
            self._calls.awaited += time.monotonic() - began

    def then(self, take: Callable[[StartedCall[R]], object]) -> None:
        """Let the component take the answer, as a message: `take` gets this call.

        In an order of their own, while nothing else of the component runs, and at once
        when the answer is there. What was cancelled is not taken.
        """
        self._is_awaited = True
        self._calls.expect()

        def turn() -> None:
            try:
                if not self._future.cancelled():
                    take(self)
            finally:
                self._calls.end()

        if self._future.done():  # what a turn on a bench raises comes out here
            self._calls.turn(turn)
        else:
            self._future.add_done_callback(lambda _: self._calls.turn(turn))

    def cancel(self) -> bool:
        """Drop the answer; return whether it was still to come.

        A call that is under way is made to its end by the callee.
        """
        return self._future.cancel()


class StartedCalls:
    """The calls that one component has started and not yet taken the answers of.

    `counts`: what they took, on threads that are not the component's.
    `awaited`: for how long their results were waited for [s].
    """

    def __init__(self, name: str, turn: Turn) -> None:
        self.turn = turn
        self._name = name
        self._changed = threading.Condition()
        self.num_open = self._num_calls = 0
        self.counts = _calls.Counts()
        self.awaited = 0.0

    def start(
        self, call: Callable[P, R], *args: P.args, **kwargs: P.kwargs
    ) -> StartedCall[R]:
        """Make a call on another thread.

        Raises RunError: `MOST_OPEN` are open, or no thread is free.
        """
        if self._num_calls >= MOST_OPEN:
            raise RunError(f"{MOST_OPEN} calls of '{self._name}' wait for answers")
        self.expect(calls=1)
        answer: Future[R] = Future()
        answer.add_done_callback(lambda _: self.end(calls=1))
        do = partial(
            _outcome, answer, partial(call, *args, **kwargs), _calls.deadline()
        )
        try:
            self._make(partial(_answer, answer, self._counted(do)))
        except RuntimeError as error:
            answer.cancel()  # or each move would wait for it
            raise RunError(f"no call of '{self._name}' is started: {error}") from error
        return StartedCall(answer, self)

    def _make(self, do: Callable[[], None]) -> None:
        _threads(self._name).submit(do)

    def _counted(self, do: Callable[[], R]) -> Callable[[], R]:
        """Return what does the same, and counts: it excludes nothing."""
        free = _calls.Exclusion(self._name)
        free.resume()
        return _calls.direct_call(do, free, math.inf, self.counts, _raise)

    def expect(self, *, calls: int = 0) -> None:
        """Count one more call, or answer to be taken, that is to be waited for."""
        with self._changed:
            self.num_open += 1
            self._num_calls += calls

    def end(self, *, calls: int = 0) -> None:
        """Count one less."""
        with self._changed:
            self.num_open -= 1
            self._num_calls -= calls
            self._changed.notify_all()

    def note_unawaited(self, answer: Future[Any]) -> None:
        """Log that a call failed whose answer nobody waits for."""
        if not answer.cancelled() and (error := answer.exception()) is not None:
            log = logging.getLogger(f"poise.component.{self._name}")
            log.error("a started call failed, and nobody takes its answer: %r", error)

    def __str__(self) -> str:
        """Return what it waits for, for people."""
        if self._num_calls:
            return f"the answers of {counted(self._num_calls, 'call')} that it started"
        return f"its turn to take {counted(self.num_open, 'answer')}"

    def wait(self, until: float) -> bool:
        """Wait until all were answered and taken, or a moment [s]; whether they are."""
        with self._changed:
            left = max(0.0, until - time.monotonic())
            return self._changed.wait_for(lambda: not self.num_open, left)


class ImmediateCalls(StartedCalls):
    """Makes each call at once and waits for it: for a component that runs alone."""

    def __init__(self) -> None:
        super().__init__("", lambda do: do())

    def _make(self, do: Callable[[], None]) -> None:
        do()


def _answer(answer: Future[R], do: Callable[[], Callable[[], None]]) -> None:
    """Make a call and set its answer, unless that is cancelled before or meanwhile."""
    if answer.cancelled():
        return
    new_chain()
    settle = do()
    if answer.set_running_or_notify_cancel():
        settle()


def _outcome(
    answer: Future[R], call: Callable[[], R], until: int
) -> Callable[[], None]:
    """Make a call until a moment; return what sets its answer."""
    _calls.set_deadline(until)
    try:
        return partial(answer.set_result, call())
    # what the caller is to see, whatever it is
    except BaseException as error:  # noqa: BLE001
        return partial(answer.set_exception, error)


def _raise(error: BaseException) -> NoReturn:
    raise error


@cache
def _threads(component: str) -> ThreadPoolExecutor:  # noqa: ARG001, each has its own
    # without that name they would count as the component's own
    return ThreadPoolExecutor(MOST_OPEN, "started", take_poise_name, ("started",))


# a process that a component forks has none of these threads, and would wait for them
os.register_at_fork(after_in_child=_threads.cache_clear)
