import random

import pytest

from poise.estimate.online import SPAN, Drift, Reading, RunningEstimate

STEP = 0.2


class Load:
    """A component that does `rate` jobs a second, each of `cost` CPU time [s]."""

    def __init__(self, rate: float, cost: float, seed: int = 0) -> None:
        self.rate, self.cost = rate, cost
        self.served = 1.0  # the share of jobs that it gets to
        self.now = self.cpu = self.wait = self.backlog = 0.0
        self.asked = self.done = 0
        self._rng = random.Random(seed)

    def reading(self, seconds: float = STEP) -> Reading:
        self.now += seconds
        came = int(self.now * self.rate) - self.asked
        self.asked += came
        self.backlog += came * self.served
        jobs, self.backlog = int(self.backlog), self.backlog % 1
        self.done += jobs
        for _ in range(jobs):
            self.cpu += self.cost * max(0.1, self._rng.gauss(1, 0.1))
        return Reading(self.now, self.cpu, self.wait, self.asked, self.done)


def drifts(running: RunningEstimate, load: Load, seconds: float) -> list[Drift]:
    found = (running.update(load.reading()) for _ in range(round(seconds / STEP)))
    return [drift for drift in found if drift]


def test_knows_nothing_before_the_second_reading() -> None:
    running = RunningEstimate()
    assert running.estimate() is None
    running.update(Reading(0.0, 0.0))
    assert running.estimate() is None


def test_estimates_mean_and_error_of_a_steady_load() -> None:
    """10 jobs a second of 5 ms: 5 % of a core."""
    running, load = RunningEstimate(), Load(10, 0.005)
    assert drifts(running, load, 40) == []
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean == pytest.approx(0.05, rel=0.03)
    assert estimate.error is not None
    assert 0 < estimate.error < 0.005
    assert (estimate.starved, estimate.drift) == (0.0, None)


def test_needs_no_less_than_nothing() -> None:
    """A call that is ended by its callee takes its CPU time away from the caller."""
    running = RunningEstimate()
    for at, cpu in ((0.0, 5.0), (1.0, 4.99)):
        running.update(Reading(at, cpu))
    found = running.estimate()
    assert found is not None
    assert found.mean == 0.0


def test_looks_back_no_further_than_its_span() -> None:
    """A slow change is followed: after the span, what was before does not count."""
    running = RunningEstimate()
    cpu = now = 0.0
    for k in range(1000):
        now, cpu = now + 1.0, cpu + (0.1 if k < 500 else 0.12)
        assert running.update(Reading(now, cpu)) is None
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean == pytest.approx(0.12)
    assert SPAN < 500


@pytest.mark.parametrize("rate", [5, 20, 50])
def test_finds_a_dearer_job_within_three_seconds(rate: float) -> None:
    for seed in range(10):
        running, load = RunningEstimate(), Load(rate, 0.1 / rate, seed)
        assert drifts(running, load, 40) == []
        load.cost *= 1.5
        (drift, *_) = drifts(running, load, 3)
        assert drift.before == pytest.approx(0.1, rel=0.05)
        drifts(running, load, 10)
        estimate = running.estimate()
        assert estimate is not None
        assert estimate.mean == pytest.approx(0.15, rel=0.08)


def test_finds_more_jobs_within_three_seconds() -> None:
    running, load = RunningEstimate(), Load(20, 0.005)
    drifts(running, load, 40)
    load.rate, load.asked, load.now = 30, 0, 0.0
    load.done = 0
    running.update(Reading(0.0, load.cpu))
    assert drifts(running, load, 3)


def test_finds_more_jobs_though_no_more_of_them_are_done() -> None:
    """It uses 0.1 cores before and after, of 0.15 that it needs."""
    running, load = RunningEstimate(), Load(20, 0.005)
    assert drifts(running, load, 40) == []
    load.asked = int(load.now * 30) - (int(load.now * 20) - load.asked)
    before = load.asked - load.done
    load.rate, load.served, load.done = 30, 2 / 3, load.asked - before
    running.skip_to_next()
    assert drifts(running, load, 3)


def test_finds_dearer_jobs_though_it_uses_no_more_for_them() -> None:
    """It does half of its jobs at twice the time: it needs 0.2 cores, and uses 0.1."""
    running, load = RunningEstimate(), Load(20, 0.005)
    assert drifts(running, load, 40) == []
    load.cost, load.served = 0.01, 0.5
    assert drifts(running, load, 3)


def steps_of(running: RunningEstimate, loads: list[float]) -> list[Drift]:
    """Return the drifts of one without jobs that uses these cores, each for a step."""
    now, cpu, found = 0.0, 0.0, [running.update(Reading(0.0, 0.0))]
    for load in loads:
        now, cpu = now + STEP, cpu + load * STEP
        found.append(running.update(Reading(now, cpu)))
    return [drift for drift in found if drift]


def test_finds_that_what_has_no_jobs_uses_more_within_three_seconds() -> None:
    running = RunningEstimate()
    (drift,) = steps_of(running, [0.1, 0.11] * 100 + [0.2, 0.21] * 8)
    assert drift.before == pytest.approx(0.105)
    assert drift.after == pytest.approx(0.205, rel=0.02)


def test_what_works_all_the_time_without_jobs_is_known_ever_better() -> None:
    running = RunningEstimate()
    errors: list[float] = []
    rng = random.Random(3)
    for seconds in (5, 25):
        running = RunningEstimate()
        loads = [0.5 + rng.uniform(-0.1, 0.1) for _ in range(round(seconds / STEP))]
        assert steps_of(running, loads) == []
        estimate = running.estimate()
        assert estimate is not None
        assert estimate.error is not None
        errors.append(estimate.error)
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.slow
@pytest.mark.parametrize("expected", [None, 0.05])
def test_finds_no_drift_in_ten_minutes(expected: float | None) -> None:
    for seed in range(5):
        running, load = RunningEstimate(expected), Load(10, 0.005, seed)
        assert drifts(running, load, 600) == []


def test_finds_a_component_that_never_was_as_profiled() -> None:
    """It takes 10 % from the start, where the profile says 5 %."""
    running, load = RunningEstimate(expected=0.05), Load(10, 0.01)
    (drift, *_) = drifts(running, load, 10)
    assert drift.before == 0.05
    assert drift.after == pytest.approx(0.1, rel=0.1)


def test_phases_that_the_profile_knows_are_no_drift() -> None:
    """Jobs of 4 ms, later of 5.5 ms: never a quarter off 4.75 % of a core."""
    running, load = RunningEstimate(expected=0.0475), Load(10, 0.004)
    found = drifts(running, load, 20)
    load.cost = 0.0055
    assert found + drifts(running, load, 20) == []


def test_little_is_no_drift_whatever_its_share_is() -> None:
    """From 1 % of a core to 1.8 %."""
    running, load = RunningEstimate(expected=0.01), Load(10, 0.001)
    drifts(running, load, 20)
    load.cost = 0.0018
    assert drifts(running, load, 20) == []
    load.cost = 0.0025
    assert drifts(running, load, 5)


@pytest.mark.parametrize(
    ("usual", "recorded"),
    [
        (3.6, [3.59, 3.47, 13.79, *[3.6] * 13, 12.18, 9.46]),
        (0.4, [0.78, 0.73, 0.58, 0.53, 0.5, 0.57, 0.43, 0.76, 10.91, 2.13, 0.8]),
    ],
)
def test_single_jobs_that_take_ten_milliseconds_more_are_no_drift(
    usual: float, recorded: list[float]
) -> None:
    """CPU time of windows [ms], recorded of steady components on a busy machine.

    Two windows with such a job once were a drift, told from the second around them.
    """
    running, rng = RunningEstimate(), random.Random(0)
    learned = [usual * rng.gauss(1, 0.03) for _ in range(100)]
    cpu = 0.0
    for count, used in enumerate([*learned, *recorded, *[usual] * 20], 1):
        cpu += 1e-3 * used
        reading = Reading(count * STEP, cpu, 0.0, 4 * count, 4 * count)
        assert running.update(reading) is None


def test_what_repeated_measurements_lay_apart_is_no_drift() -> None:
    running, load = RunningEstimate(expected=0.1, repeat=0.06), Load(10, 0.014)
    assert drifts(running, load, 30) == []
    assert drifts(RunningEstimate(expected=0.1), Load(10, 0.014), 30)


def test_counts_the_jobs_that_a_starved_component_did_not_get_to() -> None:
    """It is given CPU for half its jobs: 5 %, where it needs 10 %."""
    running, load = RunningEstimate(), Load(10, 0.01)
    load.served = 0.5
    drifts(running, load, 40)
    estimate = running.estimate()
    assert estimate is not None
    assert load.cpu / load.now == pytest.approx(0.05, rel=0.05)
    assert estimate.mean == pytest.approx(0.1, rel=0.05)
    assert estimate.starved == pytest.approx(0.5, abs=0.05)


def test_being_starved_is_no_drift() -> None:
    running, load = RunningEstimate(), Load(10, 0.01)
    drifts(running, load, 40)
    load.served = 0.4
    assert drifts(running, load, 20) == []


def test_a_lower_bound_does_not_lower_the_estimate() -> None:
    """Without jobs to count: 60 % of a core, then throttled to 20 %, always wanting."""
    running = RunningEstimate()
    cpu = now = wait = 0.0
    for k in range(200):
        now += STEP
        cpu += STEP * (0.6 if k < 100 else 0.2)
        wait += 0.0 if k < 100 else STEP * 0.8
        assert running.update(Reading(now, cpu, wait)) is None
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean == pytest.approx(0.6, rel=0.01)
    assert (estimate.starved, estimate.is_least) == (1.0, True)


def test_what_wants_more_than_it_gets_is_known_to_need_that_within_2_s() -> None:
    """Without jobs: 5 % of a core, then all that it is given, which is 35 %."""
    running = RunningEstimate()
    cpu = now = wait = 0.0
    for k in range(110):
        now += STEP
        cpu += STEP * (0.05 if k < 100 else 0.35)
        wait += 0.0 if k < 100 else STEP * 0.65
        running.update(Reading(now, cpu, wait))
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean == pytest.approx(0.35)
    assert estimate.error == pytest.approx(0.0, abs=1e-9)
    assert estimate.is_least


def test_what_has_cpu_again_is_starved_no_more() -> None:
    """Ten seconds after the last window in which it lacked CPU."""
    running = RunningEstimate()
    cpu = now = wait = 0.0
    for k in range(200):
        now += STEP
        cpu += STEP * 0.2
        wait += STEP * 0.8 if 50 <= k < 150 else 0.0
        running.update(Reading(now, cpu, wait))
    estimate = running.estimate()
    assert estimate is not None
    assert (estimate.starved, estimate.is_least) == (0.0, False)


def test_survives_a_restart_of_the_component() -> None:
    running, load = RunningEstimate(), Load(10, 0.005)
    drifts(running, load, 20)
    fresh = Load(10, 0.005)
    fresh.now = load.now
    fresh.asked = int(fresh.now * fresh.rate)
    assert drifts(running, fresh, 20) == []


class Spinning(Load):
    """One whose jobs, from some moment on, do not end."""

    ends = True

    def reading(self, seconds: float = STEP) -> Reading:
        if self.ends:
            return super().reading(seconds)
        self.now += seconds
        self.asked = int(self.now * self.rate)
        self.cpu += seconds
        return Reading(self.now, self.cpu, self.wait, self.asked, self.done)


def spinning(rate: float, cost: float, seconds: float) -> tuple[RunningEstimate, Load]:
    """Return a component that did its jobs for 25 s, and then spins."""
    running, load = RunningEstimate(), Spinning(rate, cost)
    assert drifts(running, load, 25) == []
    load.ends = False
    drifts(running, load, seconds)
    return running, load


def test_a_handler_that_never_ends_is_needed_in_full_within_3_s() -> None:
    """20 jobs a second of 1 ms, 2 %; then one that takes all of a core."""
    running, _ = spinning(20, 0.001, 3)
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean == pytest.approx(1.0, abs=0.02)
    assert estimate.error == pytest.approx(0.0, abs=0.02)
    assert 2.0 <= estimate.long_job <= 3.0
    assert estimate.drift is not None
    assert (estimate.drift.before, estimate.drift.after) == pytest.approx(
        (0.02, 1.0), rel=0.1
    )


def test_who_does_one_job_for_ever_is_not_starved() -> None:
    running, _ = spinning(20, 0.001, 10)
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.starved == 0.0


def test_a_call_that_never_ends_is_needed_in_full_within_3_s() -> None:
    """Calls count as asked for when they end: nothing seems undone."""
    running, cpu, calls = RunningEstimate(), 0.0, 0
    for k in range(125 + 15):
        is_spinning = k >= 125
        calls += 0 if is_spinning else 2
        cpu += STEP if is_spinning else 0.002
        running.update(Reading(k * STEP, cpu, 0.0, calls, calls))
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean == pytest.approx(1.0, abs=0.02)


def test_what_was_idle_needs_what_it_uses_as_soon_as_it_works() -> None:
    """It has no jobs yet: its first call has not ended."""
    running, cpu = RunningEstimate(), 0.0
    for k in range(60 + 12):
        cpu += STEP if k >= 60 else 0.0
        running.update(Reading(k * STEP, cpu))
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean == pytest.approx(1.0, abs=0.02)
    assert estimate.error is not None


def test_a_first_handler_that_never_ends_is_known() -> None:
    running, load = RunningEstimate(), Spinning(20, 0.001)
    load.ends = False
    drifts(running, load, 3)
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean == pytest.approx(1.0, abs=0.02)
    assert estimate.long_job > 0


def test_a_long_handler_that_ends_is_forgotten_within_a_second() -> None:
    running, load = spinning(20, 0.001, 10)
    assert isinstance(load, Spinning)
    load.done, load.ends = load.asked, True  # timers skip what they missed
    drifts(running, load, 1)
    estimate = running.estimate()
    assert estimate is not None
    assert estimate.mean < 0.05
    assert (estimate.long_job, estimate.drift) == (0.0, None)


def test_a_handler_that_takes_twice_its_usual_time_is_no_long_one() -> None:
    """One job of 1.5 s every 5 s; then one of 3 s."""
    running, cpu, done = RunningEstimate(), 0.0, 0
    found = []
    for k in range(250):
        at = k % 25
        cpu += STEP if at < (15 if k >= 225 else 7) else 0.0
        done += at == (15 if k >= 225 else 7)
        found.append(running.update(Reading(k * STEP, cpu, 0.0, k // 25 + 1, done)))
        estimate = running.estimate()
        assert estimate is None or k < 25 or estimate.long_job == 0.0
    assert not any(found)


def test_many_calls_between_two_jobs_are_no_long_job() -> None:
    """A timer every 20 s; from 50 s on it is called so often that it uses a core."""
    running, cpu, found = RunningEstimate(), 0.0, []
    for k in range(325):
        cpu += STEP if k >= 255 else 0.01 * STEP
        asked = k // 100
        done = asked - (k == 100)  # that job ends in the next window
        found.append(running.update(Reading(k * STEP, cpu, 0.0, asked, done)))
        estimate = running.estimate()
        assert estimate is None or estimate.long_job == 0.0
    assert any(found)
