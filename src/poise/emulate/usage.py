"""What a computer used, and whether the host kept from it what it was promised."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct

PERIOD = 0.01
"""The period over which the kernel hands out a quota [s]."""
TURNS = 0.05
"""Waiting for less than this in a second [s] is a few turns of what else a machine
does, such as the simulator's, and no busy host."""
TOLERANCE = 0.1
"""The part of the promised speed that may be missing; measured noise is below it."""


class Usage(Struct, frozen=True, kw_only=True):
    """What an emulated computer has used since it was started.

    Parameters
    ----------
    used
        CPU time [s], summed over its processes and CPUs. Without cgroups: of those
        processes that still run.
    throttled
        Time in which its quota was used up and it had to stand still [s].
    periods, throttled_periods
        Periods of its quota in which it ran at all, and in which it was throttled.
    memory
        The most that it ever held [bytes]; None when nobody counts it.
    starved
        Time in which it wanted CPU, had quota left, and the host gave the CPU to
        others [s]; None when the kernel does not tell.
    """

    used: float
    throttled: float = 0.0
    periods: int = 0
    throttled_periods: int = 0
    memory: int | None = None
    starved: float | None = None


def is_starved(before: Usage, after: Usage, quota: float, cpus: int = 1) -> bool:
    """Return whether the host made the computer slower than promised between the two.

    A computer with `quota` cores on `cpus` host CPUs was promised that, while it wants
    CPU and is not throttled, it advances at ``quota / cpus`` of a host CPU's speed or
    faster. It did advance at ``used / (used + starved)``. A run in which that is less,
    by more than `TOLERANCE`, says something about the host and nothing about the
    robot. Waiting for less than `TURNS` is never held against the host: it matters
    only beside next to no work, and the emulation promises nothing finer.

    Short starvation vanishes in a long mean: compare windows of a second or less.

    Parameters
    ----------
    quota
        What the computer was promised [host cores]; > 0.
    cpus
        How many host CPUs it may run on; >= 1.
    """
    if before.starved is None or after.starved is None:
        return False
    starved = after.starved - before.starved
    used = after.used - before.used
    promised = min(1.0, quota / cpus) * (1 - TOLERANCE)
    return starved > TURNS and used < promised * (used + starved)


def starved_time(pressure: str, throttled: float, cpus: int) -> float:
    """Return how long a cgroup was runnable, not throttled, and not running [s].

    The kernel's ``full`` CPU pressure of a cgroup is the time in which some of its
    processes could have run and none did, as a mean over the CPUs that it uses. It
    counts throttling, too, which therefore goes off again. Exact for one CPU; an
    upper bound for several, as not all of them need be in use.

    Parameters
    ----------
    pressure
        The content of the cgroup's ``cpu.pressure``.
    throttled
        For how long it was throttled, summed over its CPUs [s].
    """
    full = next(line for line in pressure.splitlines() if line.startswith("full"))
    microseconds = int(full.rpartition("total=")[2])
    return max(0.0, cpus * microseconds / 1e6 - throttled)


def stolen_time(cpus: Sequence[int]) -> float:
    """Return what a hypervisor kept from `cpus` since the machine booted [s].

    Pressure does not see it: to this kernel, the stolen time looks like running.
    """
    names = {f"cpu{number}" for number in cpus}
    lines = [line.split() for line in Path("/proc/stat").read_text().splitlines()]
    ticks_per_second = 100  # of /proc, whatever the kernel's own rate is
    return sum(int(line[8]) for line in lines if line[0] in names) / ticks_per_second
