"""Steady components on a machine that is not: how often a drift is told, and how soon.

The machine stands still for 10 to 50 ms, now and then; the component that runs just
then, if one does, seems to have used that. Once a minute it is slow for
0.2 to 1 s, and all that is done takes 1.3 to 2.5 times as long.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from poise.estimate.online import Drift, Reading, RunningEstimate

STEP = 0.2
CORES = (0.0025, 0.015, 0.005, 0.0125, 0.0075, 0.00125) * 4
"""As in `benchmarks.estimate`: 18 % of a core in all."""
JOBS = 4
"""Jobs per window."""


class Machine:
    """Makes loads unsteady that are steady; it stands still every `still` seconds."""

    def __init__(self, cores: tuple[float, ...], still: float, seed: int) -> None:
        self.cores = cores
        self._still = still
        self._rng = random.Random(seed)
        self._slow_for = 0
        self._slow_by = 1.0

    def windows(self) -> Iterator[list[float]]:
        """Give the CPU time that each component used in each window [s]."""
        while True:
            hit, hiccup = self._hiccup()
            slow = self._slowness()
            yield [
                cores * STEP * slow * self._rng.gauss(1, 0.06)
                + (hiccup if place == hit else 0.0)
                for place, cores in enumerate(self.cores)
            ]

    def _hiccup(self) -> tuple[int, float]:
        """Return whom one hits, -1 for nobody, and how long it is [s]."""
        if self._rng.random() >= STEP / self._still:
            return -1, 0.0
        anybody = [*range(len(self.cores)), -1]
        weights = [*self.cores, 1 - sum(self.cores)]
        (hit,) = self._rng.choices(anybody, weights)
        return hit, self._rng.uniform(0.01, 0.05)

    def _slowness(self) -> float:
        if self._slow_for == 0 and self._rng.random() < STEP / 60:
            self._slow_for = self._rng.randint(1, 5)
            self._slow_by = self._rng.uniform(1.3, 2.5)
        if self._slow_for == 0:
            return 1.0
        self._slow_for -= 1
        return self._slow_by


def told(
    machine: Machine, seconds: float, dearer_at: float = float("inf")
) -> list[tuple[float, Drift]]:
    """Return the drifts that are told, and when [s]."""
    estimates = [RunningEstimate() for _ in machine.cores]
    used = [0.0 for _ in machine.cores]
    found: list[tuple[float, Drift]] = []
    for count, cpu in enumerate(machine.windows(), 1):
        now, jobs = count * STEP, count * JOBS
        if now > seconds:
            return found
        for place, each in enumerate(cpu):
            used[place] += each * (1.5 if now > dearer_at else 1.0)
            reading = Reading(now, used[place], 0.0, jobs, jobs)
            drift = estimates[place].update(reading)
            if drift is not None:
                found.append((now, drift))
    raise AssertionError


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_tells_nothing_of_24_components_in_ten_minutes(seed: int) -> None:
    assert told(Machine(CORES, 1.0, seed), 600.0) == []


@pytest.mark.slow
def test_tells_of_half_as_much_again_within_three_seconds() -> None:
    """A fifth of a core: two in three. The others learned from a slow second."""
    delays = []
    for seed in range(50):
        found = told(Machine((0.2,), 10.0, seed), 80.0, dearer_at=60.0)
        delays.append(next((at for at, _ in found if at > 60.0), 90.0) - 60.0)
    delays.sort()
    assert delays[25] <= 2.4
    assert delays[33] <= 3.0
