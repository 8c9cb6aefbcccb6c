"""Threads give way, and those that go first take it back."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

import pytest

from poise.priority import REAL_TIME as REAL_TIME_WANTED
from poise.priority import (
    as_usual,
    before_components,
    give_way,
    go_first,
    goes_first,
    going_first,
)

USUAL = os.getpriority(os.PRIO_PROCESS, 0)
REAL_TIME = 1000
"""What stands for a real-time thread here."""


def nice() -> int:
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR:
        return REAL_TIME
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


def may(do: Callable[[], None]) -> bool:
    """Whether the system allows something, tried on a thread of its own."""
    outcome: list[bool] = []

    def run() -> None:
        try:
            do()
        except PermissionError:
            outcome.append(False)
        else:
            outcome.append(True)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return outcome[0]


def be_real_time() -> None:
    os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))


def be_ahead() -> None:
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), USUAL - 10)


def test_a_thread_that_gives_way_goes_last() -> None:
    seen: list[int] = []

    def run() -> None:
        give_way()
        seen.append(nice())

    on_a_thread(run)
    assert seen == [19]


def test_each_goes_before_the_next_so_far_as_it_is_allowed() -> None:
    before_usual = nice_at_best()
    seen: list[int] = []

    def run() -> None:
        with going_first():
            seen.append(nice())
        seen.append(nice())
        go_first()
        with as_usual():
            seen.append(nice())
        with before_components():
            seen.append(nice())
        seen.append(nice())

    on_a_thread(run)
    assert seen == [before_usual, USUAL, USUAL, before_usual, before_usual]


def test_real_time_is_asked_for_and_never_inherited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(REAL_TIME_WANTED, "1")
    at_first = REAL_TIME if may(be_real_time) else nice_at_best()
    seen: list[int] = []

    def run() -> None:
        go_first()
        seen.append(nice())
        on_a_thread(lambda: seen.append(nice()))

    on_a_thread(run)
    assert seen[0] == at_first
    assert seen[1] != REAL_TIME


def nice_at_best() -> int:
    return USUAL - 10 if may(be_ahead) else USUAL


def on_a_thread(do: Callable[[], object]) -> None:
    thread = threading.Thread(target=do)
    thread.start()
    thread.join()


def test_a_thread_knows_whether_it_goes_first() -> None:
    found: list[bool] = []

    def run() -> None:
        found.append(goes_first())
        go_first()
        found.append(goes_first())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found == [False, may(be_ahead)]
