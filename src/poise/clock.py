"""The one seam to time: everything that waits or stamps takes a `Clock`.

Two computers' clocks have nothing to do with each other: a time that leaves a computer
is a `Stamp`, which says whose clock it is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from msgspec import Struct

DRIFT = 50e-6
"""Two computers' clocks run apart by at most this [s/s]: crystals keep 25e-6 each."""


def wall_time() -> float:
    """Return the time of day [s since 1970], for people only: it steps, by years."""
    return time.time()  # noqa: TID251, the one place


def steady_wall_time() -> Callable[[], float]:
    """Return a clock [s since 1970] that steps no more from now on."""
    began = wall_time() - time.monotonic()
    return lambda: began + time.monotonic()


def time_of_day(moment: float) -> str:
    """Return a moment [s since 1970] for people: hours, minutes and seconds."""
    return time.strftime("%H:%M:%S", time.localtime(moment))


def date_and_time(moment: float) -> str:
    """Return a moment [s since 1970] for people, with its date."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(moment))


def boot_time() -> float:
    """Return the time [s] since this computer started, suspended or not."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def wall_time_at(boot: float) -> float:
    """Return the time of day of a moment of `boot_time` [s since 1970], for people."""
    return wall_time() - boot_time() + boot


def boot_id() -> str:
    """Return what tells this start of this computer from all others."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


class Stamp(Struct, frozen=True, array_like=True):
    """A moment `at` [s] on the clock of a computer; for fields of messages and states.

    `computer` is empty where there is only one.
    """

    at: float
    computer: str = ""


class Elapsed(Struct, frozen=True):
    """How long something took: surely within `error` of `value` [s]."""

    value: float
    error: float = 0.0

    @property
    def most(self) -> float:
        """How long it took at the longest [s]."""
        return self.value + self.error


def time_asleep() -> float:
    """Return for how long the computer has been suspended since it started [s]."""
    # a pause between two readings makes it seem less, never more
    return max([boot_time() - time.monotonic() for _ in range(2)])


class Clock(Protocol):
    """Where time comes from.

    Both methods may be called from any thread. Tests pass `poise.testing`'s
    virtual clock instead of `SystemClock`.
    """

    def now(self) -> float:
        """Return the time [s] since some fixed moment; it never steps back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Block the calling thread for `seconds` [s]."""
        ...


class ComponentClock(Clock, Protocol):
    """What components stamp and measure by; any thread may use it."""

    def stamp(self, at: float | None = None) -> Stamp:
        """Return a moment to be sent in a message: the present one, or `at`.

        `at` is a time [s] on this computer's clock, such as a device's.
        """
        ...

    def since(self, stamp: Stamp) -> Elapsed | None:
        """Return how long ago `stamp` was, whatever computer's clock it was read on.

        None: not known, because no round trip to that computer was made yet.
        """
        ...


class SystemClock:
    """The computer's monotonic clock, the same for all processes; stamps name it."""

    def __init__(self, computer: str = "") -> None:
        self._computer = computer

    def now(self) -> float:
        """Return CLOCK_MONOTONIC [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Block the calling thread for `seconds` [s]."""
        time.sleep(seconds)

    def stamp(self, at: float | None = None) -> Stamp:
        """Return the present moment, or `at` [s], as one of this computer's."""
        return Stamp(self.now() if at is None else at, self._computer)

    def since(self, stamp: Stamp) -> Elapsed | None:
        """Return how long ago a stamp of this computer was; None for another's."""
        if stamp.computer != self._computer:
            return None
        return Elapsed(self.now() - stamp.at)
