"""The CPU of a simulated computer: a fluid that groups share, as Linux lets cgroups do.

Rates change only when something begins, ends, pauses or is throttled; in between the
scheduler jumps to the next such moment. A quota is no cap of the rate: it is a bucket
that each period refills, and a group whose bucket is empty stands until then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf

from msgspec import Struct

from poise.simulation.schedule.scheduler import Scheduler, SimulatedTimer

PERIOD = 0.1
"""A quota is refilled this often [s], as `cpu.max` has it unless it is told."""
_DONE = 1e-9
"""Less work than this is none [core-seconds]."""


class CpuClaim(Struct, frozen=True):
    """What a group would use at most [cores], and its weight."""

    weight: float
    most: float


def shares(cores: float, claims: Sequence[CpuClaim]) -> list[float]:
    """Return what each claim gets [cores]: weighted max-min fairness with caps.

    No claim gets more than it can use; what that leaves goes to the others by their
    weights.
    """
    given = [0.0] * len(claims)
    left = cores
    # in this order each claim that is filled leaves more for all that come later
    order = sorted(range(len(claims)), key=lambda i: claims[i].most / claims[i].weight)
    weights = sum(claim.weight for claim in claims)
    for i in order:
        given[i] = min(claims[i].most, left * claims[i].weight / weights)
        left -= given[i]
        weights -= claims[i].weight
    return given


class Job:
    """Work of one thread [core-seconds]; `then` is called when it is done."""

    def __init__(self, work: float, then: Callable[[], object]) -> None:
        self.left = work
        self.then = then


class CpuGroup:
    """The threads of a container, or of another program.

    Parameters
    ----------
    most
        It uses no more than this at once [cores]: 1 where an interpreter's lock lets
        one thread run at a time.
    quota
        CPU time that it may use each second [cores]; infinite: any.

    Attributes
    ----------
    used, throttled
        CPU time so far [s], and how often its quota ran out.
    """

    def __init__(self, cpu: Cpu, weight: float, most: float, quota: float) -> None:
        self.weight = weight
        self.most = most
        self.quota = quota
        self.used = 0.0
        self.throttled = 0
        self.rate = 0.0
        self.bucket = quota * PERIOD
        self.is_paused = False
        self.jobs: list[Job] = []
        self._cpu = cpu

    def run(self, work: float, then: Callable[[], object]) -> Job:
        """Begin to work."""
        job = Job(work, then)
        with self._cpu.changing:
            self.jobs.append(job)
        return job

    def pause(self, *, is_paused: bool = True) -> None:
        """Stand still, or go on."""
        with self._cpu.changing:
            self.is_paused = is_paused

    def end(self) -> None:
        """Do nothing more."""
        with self._cpu.changing:
            self.jobs.clear()
            self._cpu.groups.remove(self)

    def claim(self) -> CpuClaim:
        """Return what it would use now."""
        can_run = not self.is_paused and self.bucket > _DONE
        most = min(self.most, len(self.jobs)) if can_run else 0.0
        return CpuClaim(self.weight, most)


class Cpu:
    """The cores of one computer.

    Parameters
    ----------
    cores
        How many; a slow computer has less than its number.

    Attributes
    ----------
    changing
        Entered by a group while it changes.
    """

    def __init__(self, scheduler: Scheduler, cores: float) -> None:
        self.cores = cores
        self.groups: list[CpuGroup] = []
        self.changing = self
        self._busy: list[CpuGroup] = []
        self._scheduler = scheduler
        self._at = scheduler.now
        self._refill_at = scheduler.now + PERIOD
        self._next: SimulatedTimer | None = None

    def group(
        self, weight: float = 100.0, most: float = 1.0, quota: float = inf
    ) -> CpuGroup:
        """Return a new group."""
        group = CpuGroup(self, weight, most, quota)
        self.groups.append(group)
        return group

    def __enter__(self) -> None:
        self._advance()

    def __exit__(self, *_: object) -> None:
        self._plan()

    def _advance(self) -> None:
        """Let all that runs have had its share until now."""
        passed, self._at = self._scheduler.now - self._at, self._scheduler.now
        for group in self._busy:
            done = group.rate * passed
            group.used += done
            if group.quota < inf:
                was_full = group.bucket > _DONE
                group.bucket = max(0.0, group.bucket - done)
                group.throttled += was_full and group.bucket <= _DONE
            for job in group.jobs:
                job.left -= done / len(group.jobs)
        if self._scheduler.now >= self._refill_at:
            while self._refill_at <= self._scheduler.now:
                self._refill_at += PERIOD
            for group in self.groups:
                group.bucket = group.quota * PERIOD

    def _plan(self) -> None:
        """Share out anew, and plan the next moment at which that changes."""
        self._busy = [group for group in self.groups if group.jobs]
        rates = shares(self.cores, [group.claim() for group in self._busy])
        moments = []
        for group, rate in zip(self._busy, rates, strict=True):
            group.rate = rate
            if rate > 0:
                least = min(job.left for job in group.jobs)
                moments.append(self._at + least * len(group.jobs) / rate)
                moments.append(self._at + group.bucket / rate)
            elif group.bucket <= _DONE:
                moments.append(self._refill_at)
            if group.quota < inf and rate > 0:
                moments.append(self._refill_at)
        if self._next is not None:
            self._next.cancel()
            self._next = None
        first = min(moments, default=inf)
        if first < inf:
            # a moment that rounding puts before now would never come
            at = max(first, self._scheduler.now)
            self._next = self._scheduler.at(at, self._change)

    def _change(self) -> None:
        self._next = None
        done: list[Job] = []
        with self.changing:
            for group in self._busy:
                done += [job for job in group.jobs if job.left <= _DONE]
                group.jobs = [job for job in group.jobs if job.left > _DONE]
        for job in done:
            job.then()
