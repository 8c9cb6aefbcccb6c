"""Releases and misses of the engine's timers, against those of real components."""

from __future__ import annotations

from random import Random

import pytest

from poise.runtime.component.ports import Timer
from poise.runtime.execution.timers import Timers
from poise.simulation._engine import Engine
from poise.wire.records.status_records import TimerStatus
from tests.simulation.native.parts import advance, container, model, worker

Pauses = list[tuple[float, float]]


def real(timer: Timer, factors: list[float], pauses: Pauses, end: float) -> TimerStatus:
    """Return what the timers of a real component count."""
    timers, free = Timers({timer.name: timer}), 0.0
    timers.start(0.0)
    for pause, resume in (*pauses, (end, end)):
        (releases,) = timers
        while (began := max(free, releases.due)) < pause:
            release = releases.begin(began)
            free = began + WORK * factors[int(began) % len(factors)]
            if free < end:
                releases.end(release, began, free)
        if pause < end:
            timers.stop(pause)
            timers.start(resume, resume)
    (status,) = timers.status(end)
    return status


def simulated(
    timer: Timer, factors: list[float], pauses: Pauses, end: float
) -> TimerStatus:
    """Return what those of a simulated component count."""
    engine = Engine(1)
    tick = (timer.name, timer.period, timer.deadline, engine.handler(WORK))
    executor = worker(container(engine), "it", model(engine, [tick], factors=factors))
    for pause, resume in pauses:
        advance(engine, pause)
        executor.pause()
        advance(engine, resume)
        executor.resume()
        executor.work()
    advance(engine, end)
    (status,) = executor.timers(end)
    return status


WORK = 0.05


@pytest.mark.parametrize("seed", range(40))
def test_they_count_what_those_of_real_components_count(seed: int) -> None:
    """Some runs are longer than the period, and some pauses fall into runs."""
    random = Random(seed)
    deadline = random.choice([None, 0.03, 0.1, 0.3])
    timer = Timer("tick", random.uniform(0.05, 0.3), deadline)
    factors = [random.choice([0.1, 0.5, 2.0, 7.0]) for _ in range(5)]
    moments = sorted(random.uniform(0.0, 9.0) for _ in range(4))
    pauses = [(moments[0], moments[0] + 1.0), (moments[-1] + 1.0, moments[-1] + 1.7)]
    if pauses[1][0] < pauses[0][1]:
        pauses.pop()
    found = simulated(timer, factors, pauses, 12.0)
    known = real(timer, factors, pauses, 12.0)
    assert (found.releases, found.missed) == (known.releases, known.missed)
    for mine, its in (
        (found.lateness, known.lateness),
        (found.duration, known.duration),
    ):
        assert mine.count == its.count
        assert mine.mean == pytest.approx(its.mean, abs=1e-9)
        assert mine.maximum == pytest.approx(its.maximum, abs=1e-9)


def test_a_move_keeps_the_phase_of_a_timer() -> None:
    engine = Engine(1)
    tick = ("tick", 1.0, None, engine.handler(0.01))
    before = worker(container(engine), "it", model(engine, [tick]))
    engine.run(2.3)
    after = container(engine).add(("it", 1), 2, model(engine, [tick]), [])
    after.restore(before.hand_over())
    before.deactivate()
    after.set_wanted(True)
    after.activate()
    engine.run(3.05)
    assert (before.done, after.done) == (2, 1)
    (status,) = after.timers(3.05)
    assert status.lateness.maximum == pytest.approx(0.0, abs=1e-9)
