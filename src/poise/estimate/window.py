"""Readings of a component's counters, and the windows between them."""

from __future__ import annotations

from msgspec import Struct

_SATURATED = 0.9
"""A component that is runnable for this share of a window may need more than it got."""
_STARVED = 0.1
"""A component that waits for this share of its runnable time is starved."""


class Reading(Struct, frozen=True):
    """A component's counters since it was activated.

    Parameters
    ----------
    at
        When they were read [s], on the clock of its own computer.
    cpu
        CPU time used [s].
    wait
        Time in which it was runnable and did not run, because other processes ran or
        its computer was throttled [s].
    asked, done
        Jobs (releases of timers, messages, calls) that arrived, and that ended.
    """

    at: float
    cpu: float
    wait: float = 0.0
    asked: int = 0
    done: int = 0


class Window(Struct, frozen=True):
    """The work of a component between two readings.

    Parameters
    ----------
    seconds
        Length [s]; > 0.
    cpu
        CPU time used [s]. A call counts for its caller until it ends, then for its
        callee: a window in which a long call ends may be below zero.
    asked, done
        Jobs that arrived, and that ended.
    is_cut
        Whether it was runnable nearly all the time and waited often, so that its CPU
        time is only a lower bound of its demand.
    """

    seconds: float
    cpu: float
    asked: int = 0
    done: int = 0
    is_cut: bool = False


def window_between(before: Reading, after: Reading) -> Window | None:
    """Return the window between two readings; None when there is none.

    There is none when no time passed, or when the component restarted: its counters
    are then lower, or its CPU time is no more than the time since.
    """
    seconds = after.at - before.at
    cpu, wait = after.cpu - before.cpu, after.wait - before.wait
    asked, done = after.asked - before.asked, after.done - before.done
    is_new = min(wait, asked, done) < 0 or (cpu < 0 and after.cpu <= seconds)
    if seconds <= 0 or is_new:
        return None
    wanted = cpu + wait
    return Window(
        seconds,
        cpu,
        asked,
        done,
        wanted >= _SATURATED * seconds and wait >= _STARVED * wanted,
    )
