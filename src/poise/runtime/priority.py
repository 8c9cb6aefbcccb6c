"""Which threads go first: those that carry orders, then components, then preparations.

Linux has a nice value for each thread, and gives it to the threads that one starts.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import TypeVar

_USUAL = os.getpriority(os.PRIO_PROCESS, 0)
_FIRST, _LAST = _USUAL - 10, 19

T = TypeVar("T")


def go_first() -> None:
    """Let this thread go before those that run components, if the system allows it.

    For work that takes little time and that others wait for.
    """
    with contextlib.suppress(PermissionError):
        _be_nice(_FIRST)


@contextmanager
def first() -> Iterator[None]:
    """Let this thread, and those that it starts meanwhile, go first for a while."""
    go_first()
    try:
        yield
    finally:
        _be_nice(_USUAL)


@contextmanager
def as_usual() -> Iterator[None]:
    """Let a thread that goes first, and those that it starts, be as all others."""
    _be_nice(_USUAL)
    try:
        yield
    finally:
        go_first()


def gently(work: Callable[[], T]) -> T:
    """Run `work` on a thread that gives way to all others, and return what it returns.

    A thread of its own, because only the privileged may take back that they gave way.

    Raises
    ------
    BaseException
        Whatever `work` raises.
    """
    future: Future[T] = Future()

    def run() -> None:
        _be_nice(_LAST)
        try:
            future.set_result(work())
        except BaseException as error:  # noqa: BLE001, the caller gets it
            future.set_exception(error)

    threading.Thread(target=run, name="gently").start()
    return future.result()


def _be_nice(value: int) -> None:
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), value)
