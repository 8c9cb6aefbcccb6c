"""The CPU of a simulated computer: a fluid that groups share, as Linux lets cgroups do.

Rates change only when something begins, ends, pauses or is throttled; in between the
scheduler jumps to the next such moment. A quota is no cap of the rate: it is a bucket
that each period refills, and a group whose bucket is empty stands until then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import NamedTuple

from poise.simulation.schedule.scheduler import Scheduler, SimulatedTimer

PERIOD = 0.1
"""A quota is refilled this often [s], as `cpu.max` has it unless it is told."""
_DONE = 1e-9
"""Less work than this is none [core-seconds]."""


class CpuClaim(NamedTuple):
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

    __slots__ = ("left", "then")

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
            if len(self.jobs) == 1:
                self._cpu.busy.append(self)
        return job

    def pause(self, *, is_paused: bool = True) -> None:
        """Stand still, or go on."""
        with self._cpu.changing:
            self.is_paused = is_paused

    def end(self) -> None:
        """Do nothing more."""
        with self._cpu.changing:
            if self.jobs:
                self.jobs.clear()
                self._cpu.busy.remove(self)
            self._cpu.groups.remove(self)
            self._cpu.ended += self.used

    def could_use(self) -> float:
        """Return what it would use now [cores]."""
        can_run = not self.is_paused and self.bucket > _DONE
        return min(self.most, len(self.jobs)) if can_run else 0.0


class Cpu:
    """The cores of one computer.

    Parameters
    ----------
    cores
        How many.
    speed
        Work that a core does in a second [core-seconds of the reference].

    Attributes
    ----------
    groups, busy
        All groups, and those that have something to do.
    ended
        The work of groups that have ended [core-seconds].
    changing
        Entered by a group while it changes; several changes at once cost one.
    """

    def __init__(self, scheduler: Scheduler, cores: float, speed: float = 1.0) -> None:
        self.cores = cores
        self.speed = speed
        self.groups: list[CpuGroup] = []
        self.busy: list[CpuGroup] = []
        self.ended = 0.0
        self.changing = self
        self._depth = 0
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
        if not self._depth:
            self._advance()
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if not self._depth:
            self._plan()

    def used(self) -> float:
        """Return the work of all groups that there are, so far [core-seconds]."""
        with self.changing:
            return self.ended + sum(group.used for group in self.groups)

    def _advance(self) -> None:
        """Let all that runs have had its share until now."""
        passed, self._at = self._scheduler.now - self._at, self._scheduler.now
        for group in self.busy:
            done = group.rate * passed
            group.used += done
            if group.quota < inf:
                was_full = group.bucket > _DONE
                group.bucket = max(0.0, group.bucket - done)
                group.throttled += was_full and group.bucket <= _DONE
            each = done / len(group.jobs)
            for job in group.jobs:
                job.left -= each
        if self._scheduler.now >= self._refill_at:
            while self._refill_at <= self._scheduler.now:
                self._refill_at += PERIOD
            for group in self.groups:
                group.bucket = group.quota * PERIOD

    def _plan(self) -> None:
        """Share out anew, and plan the next moment at which that changes."""
        first = inf
        for group, rate in zip(self.busy, self._rates(), strict=True):
            group.rate = rate * self.speed
            if rate > 0:
                least = min(job.left for job in group.jobs)
                first = min(first, self._at + least * len(group.jobs) / group.rate)
            if group.quota < inf and (rate > 0 or group.bucket <= _DONE):
                empty = self._at + group.bucket / group.rate if rate > 0 else inf
                first = min(first, empty, self._refill_at)
        if self._next is not None:
            self._next.cancel()
            self._next = None
        if first < inf:
            # a moment that rounding puts before now would never come
            at = max(first, self._scheduler.now)
            self._next = self._scheduler.at(at, self._change)

    def _rates(self) -> list[float]:
        """Return what each busy group gets [cores]."""
        most = [group.could_use() for group in self.busy]
        if sum(most) <= self.cores:
            return most
        weights = [group.weight for group in self.busy]
        return shares(self.cores, list(map(CpuClaim, weights, most)))

    def _change(self) -> None:
        self._next = None
        with self.changing:
            done: list[Job] = []
            for group in self.busy:
                if any(job.left <= _DONE for job in group.jobs):
                    done += [job for job in group.jobs if job.left <= _DONE]
                    group.jobs = [job for job in group.jobs if job.left > _DONE]
            self.busy = [group for group in self.busy if group.jobs]
            for job in done:
                job.then()
