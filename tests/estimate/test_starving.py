"""The estimate of a component that needs more than it gets, by simulation."""

from __future__ import annotations

import random

import pytest

from poise.estimate.online import Estimate, Reading, RunningEstimate

STEP = 0.2
TICK = 0.001


class Starving:
    """A timer's jobs, of `cost` CPU time [s], that get `quota` cores.

    A release is skipped while the one before it still waits.
    """

    def __init__(self, rate: float, cost: float, quota: float, seed: int) -> None:
        self.rate, self.cost, self.quota = rate, cost, quota
        self._rng = random.Random(seed)
        self._phase = self._rng.random() / rate
        self._ticks = self._asked = self._done = 0
        self._cpu = self._left = 0.0
        self._is_waiting = False

    def reading(self) -> Reading:
        for _ in range(round(STEP / TICK)):
            self._tick()
        return Reading(self._ticks * TICK, self._cpu, 0.0, self._asked, self._done)

    def _tick(self) -> None:
        self._ticks += 1
        asked = int((self._ticks * TICK + self._phase) * self.rate)
        self._is_waiting |= asked > self._asked
        self._asked = asked
        if self._left <= 0 and self._is_waiting:
            self._is_waiting = False
            self._left = self.cost * self._rng.uniform(0.9, 1.1)
        if self._left > 0:
            self._left -= TICK * self.quota
            self._cpu += TICK * self.quota
            self._done += self._left <= 0


def told(running: RunningEstimate, load: Starving, seconds: float) -> list[Estimate]:
    """Return the estimates after each reading."""
    found = []
    for _ in range(round(seconds / STEP)):
        running.update(load.reading())
        estimate = running.estimate()
        if estimate is not None:
            found.append(estimate)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "quota"), [(20, 0.2), (20, 0.1), (5, 0.2), (2, 0.2), (2, 0.1), (1, 0.2)]
)
def test_is_never_far_too_high_after_a_shift(rate: float, quota: float) -> None:
    """It needed 2 % of a core and needs 40 %; it gets half of that, or a quarter.

    What is said with an error is right within that or a quarter.
    """
    for seed in range(5):
        running, load = RunningEstimate(), Starving(rate, 0.02 / rate, quota, seed)
        told(running, load, 20)
        load.cost = 0.4 / rate
        after = [each for each in told(running, load, 60) if each.drift is not None]
        assert max(each.mean for each in after) < 1.5 * 0.4
        for each in after:
            if each.error is not None:
                assert abs(each.mean - 0.4) <= max(each.error, 0.1)
        assert after[-1].mean == pytest.approx(0.4, rel=0.1)
        assert after[-1].starved == pytest.approx(1 - quota / 0.4, abs=0.15)


def test_what_waited_and_is_worked_off_is_not_needed() -> None:
    """10 % of a core; starved for a minute, then with all its messages at once."""
    running = RunningEstimate()
    cpu = now = 0.0
    asked = done = waiting = 0
    drifts = []
    for k in range(600):
        now, asked, waiting = now + STEP, asked + 4, waiting + 4
        room = 2 if 200 <= k < 300 else 8
        did = min(room, waiting)
        done, waiting, cpu = done + did, waiting - did, cpu + did * 0.005
        drifts.append(running.update(Reading(now, cpu, 0.0, asked, done)))
        estimate = running.estimate()
        if estimate is not None:
            assert estimate.mean == pytest.approx(0.1, rel=0.05)
    assert not any(drifts)
