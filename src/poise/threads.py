"""Threads whose failures are reported, and how work goes on after a failure."""

from __future__ import annotations

import atexit
import contextlib
import errno
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import get_native_id

from poise.errors import RunError, Timeout

log = logging.getLogger(__name__)

PROCESS_LIMIT = (
    "the limit of processes (`ulimit -u`, TasksMax of a service, pids.max of a cgroup)"
)
NO_THREAD = (
    f"no thread can be started: raise {PROCESS_LIMIT}, or that of memory (`ulimit -v`)"
)
_REMEDIES = {
    errno.EAGAIN: f"raise {PROCESS_LIMIT}",
    errno.EMFILE: "raise the limit of open files (`ulimit -n`)",
    errno.EFBIG: "raise the limit of a file's size (`ulimit -f`), best to unlimited",
    errno.ENOMEM: "no memory is free: give its computer more",
}
_NAME_LIMIT = 15
"""The kernel keeps so much of a thread's name [bytes]."""
SHOWN_FOR = 60.0
"""A failure is shown for this time [s]."""

Hook = Callable[[threading.ExceptHookArgs], object]


def hear_failures(report: Callable[[str, BaseException], object]) -> None:
    """Report exceptions that end any thread of this process; the last call counts."""
    threading.excepthook = _hook(report)


@contextlib.contextmanager
def failures_heard(report: Callable[[str, BaseException], object]) -> Iterator[None]:
    """Report them inside the ``with`` block, beside what the process has installed."""
    before = threading.excepthook
    is_default = before is threading.__excepthook__  # it prints what the log has
    mine = threading.excepthook = _hook(report, None if is_default else before)
    try:
        yield
    finally:
        if threading.excepthook is mine:
            threading.excepthook = before


def _hook(
    report: Callable[[str, BaseException], object], others: Hook | None = None
) -> Hook:
    def hook(args: threading.ExceptHookArgs) -> None:
        name = args.thread.name if args.thread is not None else "unknown"
        error = args.exc_value or args.exc_type()
        if isinstance(error, SystemExit):
            return
        log.error("thread '%s' failed", name, exc_info=error)
        try:
            report(name, error)
        except Exception:  # the log has both
            log.exception("the failure of thread '%s' could not be reported", name)
        if others is not None:
            others(args)

    return hook


def is_lack_of_threads(error: BaseException) -> bool:
    """Return whether no thread was free: Python has no class for this error."""
    return isinstance(error, RuntimeError) and str(error) == "can't start new thread"


def explained(error: Exception) -> Exception:
    """Return a RunError with a way out where no thread is free; else the same error."""
    return RunError(NO_THREAD) if is_lack_of_threads(error) else error


def without_process(error: OSError) -> str:
    """Return why a process cannot be started, and a way out, for people."""
    return f"cannot be started: {error.strerror or error}{remedy_of(error)}"


def remedy_of(error: OSError) -> str:
    """Return which limit to raise, after a colon; empty: none is known."""
    remedy = _REMEDIES.get(error.errno or 0, "")
    return f": {remedy}" if remedy else ""


class Failures:
    """The failures of a program's threads, for its status."""

    def __init__(self, program: str) -> None:
        self._program = program
        self._last = "", float("-inf")

    def note(self, thread: str, error: BaseException) -> None:
        """Take note of a failure, as `hear_failures` reports it."""
        text = f"in {self._program} the thread '{thread}' failed: {error!r}"
        self._last = f"{text} (`poise log` has the traceback)", time.monotonic()

    def trouble(self) -> str:
        """Return the last failure, if it was within `SHOWN_FOR`; else nothing."""
        text, at = self._last
        return text if time.monotonic() - at < SHOWN_FOR else ""


def daemon(
    work: Callable[..., object], name: str, *args: object, again: bool = False
) -> threading.Thread:
    """Return a thread that ends with the process; `again`: its work is repeated."""
    target = (keep_at, work) if again else (work,)
    given = (name, *target, *args)
    return threading.Thread(target=_named, name=name, args=given, daemon=True)


def take_name(name: str) -> None:
    """Give this thread a name for the kernel, too, which what it starts inherits.

    The main thread keeps its own: it is the process's. Long names differ at either end.
    """
    short = name.encode()
    if len(short) > _NAME_LIMIT:
        short = short[: _NAME_LIMIT // 2] + b"~" + short[-(_NAME_LIMIT // 2) :]
    if get_native_id() != os.getpid():
        with contextlib.suppress(OSError):
            Path("/proc/thread-self/comm").write_bytes(short)


def take_poise_name(name: str) -> None:
    """Give this thread a name that no component has."""
    take_name(f"poise {name}")


def _named(name: str, work: Callable[..., object], *args: object) -> None:
    take_poise_name(name)
    work(*args)


_LAST_WAIT = 15.0
"""At its end an interpreter waits so long for a library's code [s]."""
_abandoned: list[threading.Thread] = []


def abandon(thread: threading.Thread) -> None:
    """Wait no longer for a thread that is in a library's code.

    If it came back while the interpreter ends, that would abort the process: a script
    waits for it, and a command ends without (`is_any_abandoned`).
    """
    _abandoned[:] = [*filter(threading.Thread.is_alive, _abandoned), thread]


def is_any_abandoned() -> bool:
    """Return whether an abandoned thread has not come back yet."""
    return any(thread.is_alive() for thread in _abandoned)


@atexit.register
def _wait_for_abandoned() -> None:
    until = time.monotonic() + _LAST_WAIT
    for thread in _abandoned:
        thread.join(max(0.0, until - time.monotonic()))


def report_failure() -> None:
    """Report the exception that is being handled, though its thread goes on."""
    failure = (*sys.exc_info(), threading.current_thread())
    threading.excepthook(threading.ExceptHookArgs(failure))


def keep_at(work: Callable[..., object], *args: object) -> None:
    """Do work on this thread until it returns; again after each exception."""
    back_off = BackOff()
    while True:
        try:
            work(*args)
        except Exception:  # noqa: BLE001, it is reported
            report_failure()
        else:
            return
        now = time.monotonic()
        back_off.note_end(now)
        if back_off.again_at > now:
            time.sleep(back_off.again_at - now)


def poll_until(
    holds: Callable[[], bool], deadline: float, late: str, every: float = 0.001
) -> None:
    """Wait for what nobody reports; Timeout, which says `late`, at `deadline` [s]."""
    while not holds():
        if time.monotonic() > deadline:
            raise Timeout(late)
        time.sleep(every)


_FIRST_DELAY, LONGEST_DELAY = 0.1, 5.0
"""The second restart is after this time [s], the next after twice that, to this."""
_CALM = 10.0
"""After so long without an end the next restart is at once again [s]."""


class BackOff:
    """The ends of one process, and when it may start again [s]."""

    def __init__(self) -> None:
        self.again_at = float("-inf")
        self._delay = 0.0
        self._ended_at = float("-inf")

    def note_end(self, now: float, jitter: float = 1.0) -> None:
        """Count an end at `now` [s]; `jitter` in [0.5, 1] spreads many over time."""
        if now - self._ended_at > _CALM:
            self._delay = 0.0
        self._ended_at = now
        self.again_at = now + self._delay * jitter
        self._delay = min(max(_FIRST_DELAY, 2 * self._delay), LONGEST_DELAY)
