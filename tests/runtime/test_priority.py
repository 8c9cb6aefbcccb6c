"""Threads give way, and those that go first take it back."""

from __future__ import annotations

import os
import threading

import pytest

from poise.runtime.priority import as_usual, gently, go_first


def nice() -> int:
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


def test_gives_way_only_on_a_thread_of_its_own() -> None:
    before = nice()
    assert gently(nice) == 19
    assert nice() == before


def test_what_is_raised_gently_is_raised_here() -> None:
    with pytest.raises(ZeroDivisionError):
        gently(lambda: 1 // 0)


def test_goes_first_where_it_is_allowed() -> None:
    seen: list[int] = []

    def run() -> None:
        go_first()
        seen.append(nice())
        with as_usual():
            seen.append(nice())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    usual = nice()
    assert seen in ([usual - 10, usual], [usual, usual])
