"""What a component's counters say, and the windows between two readings."""

from __future__ import annotations

from msgspec import Struct

_SATURATED = 0.9
"""Who wanted to run for this share of a window may have wanted more than it got."""
_STARVED = 0.1
"""Who waited for this share of the time it wanted to run was kept from running."""


class Reading(Struct, frozen=True):
    """A component's counters since it was activated.

    Parameters
    ----------
    at
        When they were read [s], on the clock of its own computer.
    cpu
        CPU time used [s].
    wait
        Time in which it could have run and did not: other processes ran, or its
        computer was throttled [s].
    asked, done
        Jobs (releases of timers, messages, calls) that came, and that were ended.
    """

    at: float
    cpu: float
    wait: float = 0.0
    asked: int = 0
    done: int = 0


class Window(Struct, frozen=True):
    """What a component did between two readings.

    Parameters
    ----------
    seconds
        Length [s]; > 0.
    cpu
        CPU time used [s]. What a call used counts for its caller until it ends, then
        for its callee: a window in which a long call ends may be below zero.
    asked, done
        Jobs that came and that were ended.
    is_cut
        Whether it wanted to run nearly all the time and was often kept from it, so
        that its CPU time is only a lower bound of its demand.
    """

    seconds: float
    cpu: float
    asked: int = 0
    done: int = 0
    is_cut: bool = False


def window_between(before: Reading, after: Reading) -> Window | None:
    """Return the window between two readings; None when there is none.

    There is none when no time passed, or when the component was started anew: then it
    has done less than before, or has used no more than there was time for since.
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
