"""The limits of each emulated computer on the host, and whether the host starved it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import Struct

from poise.errors import RobotError
from poise.model.robot import Computer

_SMALLEST = 0.001
"""The kernel refuses quotas of less than this in a period [s]."""
_LONGEST = 1.0
"""The kernel refuses longer periods [s]."""
_ROUNDING = 1e-9


class Limits(Struct, frozen=True, kw_only=True):
    """The limits of one emulated computer."""

    quota: float  # host cores; 0.001 at least
    cpus: tuple[int, ...]  # the host CPUs that it may run on; one at least
    memory: int | None = None  # [bytes]; None: no limit

    @property
    def period_us(self) -> int:
        """The period of its quota [us]: `PERIOD`, longer for a very small quota."""
        return round(max(PERIOD, _SMALLEST / self.quota) * 1e6)

    @property
    def quota_us(self) -> int:
        """Its CPU time in each period [us]; 0: no limit, as it may fill its CPUs."""
        throttles = self.quota < len(self.cpus)
        return round(self.quota * self.period_us) if throttles else 0

    @property
    def cpu_list(self) -> str:
        """Its CPUs, as the kernel and ``taskset`` take them."""
        return ",".join(map(str, self.cpus))


def share_out(computers: Sequence[Computer], cpus: Sequence[int]) -> list[Limits]:
    """Return the limits of each computer on a host with `cpus`.

    A computer gets its own CPUs, as many as its quota can fill (so that throttled time
    is spread over all of them, as `starved_time` assumes). If CPUs are short, each
    computer gets one; if there are fewer CPUs than computers, they share them.
    """
    quotas = [_quota(computer) for computer in computers]
    if len(cpus) < len(computers):
        sets: list[tuple[int, ...]]
        sets = [(cpus[i % len(cpus)],) for i, _ in enumerate(computers)]
    else:
        sets = _own_sets(quotas, list(cpus))
    return [
        Limits(quota=quota, cpus=own, memory=_memory(computer))
        for computer, quota, own in zip(computers, quotas, sets, strict=True)
    ]


def shortages(limits: Mapping[str, Limits]) -> list[str]:
    """Return a sentence for each computer and CPU that is too small."""
    slow = [
        f"{name!r} asks for {limit.quota:g} host cores and gets {len(limit.cpus)}: "
        "it is slower than the robot file says"
        for name, limit in limits.items()
        if limit.quota > len(limit.cpus) + _ROUNDING
    ]
    cpus = sorted({cpu for limit in limits.values() for cpu in limit.cpus})
    shared = [
        _sharing(cpu, {n: li.quota for n, li in limits.items() if cpu in li.cpus})
        for cpu in cpus
    ]
    return slow + [sentence for sentence in shared if sentence]


def _sharing(cpu: int, quotas: Mapping[str, float]) -> str:
    if len(quotas) == 1:
        return ""
    asked = sum(quotas.values())
    return (
        f"CPU sets of their own: {', '.join(quotas)} share host CPU {cpu}, as there "
        f"are more computers than CPUs; they ask for {asked:g} of it"
        + (", which is more than it has" if asked > 1 + _ROUNDING else "")
    )


def _quota(computer: Computer) -> float:
    quota = computer.capacity.get("cpu", 0.0) * computer.speed
    least = _SMALLEST / _LONGEST
    if not least <= quota < math.inf:
        raise RobotError(
            f"computer {computer.name!r} cannot be emulated with {quota:g} cores "
            f"(cpu capacity x speed); it must be at least {least:g}, and finite"
        )
    return quota


def _memory(computer: Computer) -> int | None:
    amount = computer.capacity.get("memory", math.inf)
    return int(amount) if 0 < amount < math.inf else None


def _own_sets(quotas: Sequence[float], cpus: list[int]) -> list[tuple[int, ...]]:
    sets: list[list[int]] = [[cpus.pop(0)] for _ in quotas]
    for quota, own in zip(quotas, sets, strict=True):
        more = min(len(cpus), math.ceil(quota - _ROUNDING) - 1)
        own += [cpus.pop(0) for _ in range(more)]
    return [tuple(own) for own in sets]


PERIOD = 0.01
"""The period of a CPU quota [s]."""
TURNS = 0.05
"""Waiting for less than this in a second [s] is normal beside other processes, such as
the simulator."""
TOLERANCE = 0.1
"""The share of the promised speed that may be missing; noise is below it."""


class Usage(Struct, frozen=True, kw_only=True):
    """The usage of an emulated computer since it was started."""

    # CPU time [s], summed over its processes and CPUs. Without cgroups: of those
    # processes that still run
    used: float
    # time in which it did not run because its quota was used up [s]
    throttled: float = 0.0
    memory: int | None = None  # peak [bytes]; None when it is not counted
    # time in which it wanted CPU, had quota left, and other processes ran [s], without
    # what is prepared on it; None when the kernel does not count it
    starved: float | None = None


def is_starved(before: Usage, after: Usage, quota: float, cpus: int = 1) -> bool:
    """Return whether the host made the computer slower than promised between the two.

    The emulation promises that a computer with `quota` cores on `cpus` host CPUs, while
    it wants CPU and is not throttled, advances at ``quota / cpus`` of a host CPU's
    speed or faster. It advanced at ``used / (used + starved)``. If that is less by more
    than `TOLERANCE`, the measurement describes the host and not the robot. Waiting for
    less than `TURNS` is ignored.

    Short starvation vanishes in a long mean: compare windows of a second or less.
    """
    if before.starved is None or after.starved is None:
        return False
    starved = after.starved - before.starved
    used = after.used - before.used
    promised = min(1.0, quota / cpus) * (1 - TOLERANCE)
    return starved > TURNS and used < promised * (used + starved)


def starved_time(
    pressure: str, throttled: float, cpus: int, prepared: str = ""
) -> float | None:
    """Return how long a cgroup was runnable, not throttled, and not running [s].

    The kernel's ``full`` CPU pressure of a cgroup is the time in which some of its
    processes were runnable and none ran, as a mean over its CPUs; None where it only
    counts ``some``. It includes throttled time, which is subtracted. The result is
    exact for one CPU and an upper bound for several, because not all of them need be
    in use.

    `prepared`: the pressure of a group within, which gets only what others leave. What
    waits there is not starved, so its pressure is subtracted, too. It may wait while
    others run: only the difference of two results means something, and while there is
    something that waits, it is a lower bound.
    """
    full = _full_pressure(pressure)
    if full is None:
        return None
    return cpus * (full - (_full_pressure(prepared) or 0.0)) - throttled


def _full_pressure(pressure: str) -> float | None:
    for line in pressure.splitlines():
        if line.startswith("full"):
            return int(line.rpartition("total=")[2]) / 1e6
    return None
