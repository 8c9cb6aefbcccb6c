"""Releases, misses and skips, worked out by hand: a timer every 100 ms, due in 50."""

from __future__ import annotations

import pytest

from poise.runtime.component.ports import Timer
from poise.runtime.execution.timers import Releases, Timers, release_offset
from poise.wire.records.status_records import TimerStatus

START = 10.0


@pytest.fixture
def schedule() -> Releases:
    return Releases(Timer("tick", 0.1, 0.05), START)


def run(schedule: Releases, began: float, ended: float) -> float:
    """Run from `began` to `ended`, counted from activation; return the release."""
    release = schedule.begin(START + began)
    schedule.end(release, START + began, START + ended)
    return round(release - START, 9)


def status(schedule: Releases, at: float) -> TimerStatus:
    return schedule.status(START + at)


def test_releases_lie_at_multiples_of_the_period(schedule: Releases) -> None:
    for k in (1, 2, 3):
        assert schedule.due == pytest.approx(START + 0.1 * k)
        assert run(schedule, 0.1 * k + 0.01, 0.1 * k + 0.02) == pytest.approx(0.1 * k)
    assert status(schedule, 0.35).releases == 3
    assert status(schedule, 0.35).missed == 0


def test_lateness_and_duration_are_measured(schedule: Releases) -> None:
    run(schedule, 0.11, 0.13)
    told = status(schedule, 0.15)
    assert told.lateness.maximum == pytest.approx(0.01)
    assert told.duration.maximum == pytest.approx(0.02)


def test_a_run_that_ends_after_its_deadline_missed_it(schedule: Releases) -> None:
    run(schedule, 0.1, 0.149)
    assert status(schedule, 0.16).missed == 0
    run(schedule, 0.2, 0.251)
    assert status(schedule, 0.26).missed == 1


def test_waiting_counts_towards_the_deadline(schedule: Releases) -> None:
    run(schedule, 0.145, 0.155)  # 10 ms of work, begun 45 ms late
    assert status(schedule, 0.16).missed == 1


def test_of_several_that_passed_the_last_is_run_and_the_others_missed(
    schedule: Releases,
) -> None:
    run(schedule, 0.1, 0.42)  # over the releases at 0.2, 0.3 and 0.4
    assert run(schedule, 0.42, 0.43) == pytest.approx(0.4)
    told = status(schedule, 0.45)
    assert told.releases == 4
    assert told.missed == 3  # the first was late; 0.2 and 0.3 never began
    assert schedule.due == pytest.approx(START + 0.5)


def test_without_a_deadline_nothing_is_missed() -> None:
    schedule = Releases(Timer("tick", 0.1), START)
    run(schedule, 0.1, 0.42)
    run(schedule, 0.42, 0.43)
    assert status(schedule, 0.45).releases == 4
    assert status(schedule, 0.45).missed == 0


def test_what_should_have_begun_counts_while_a_run_goes_on(schedule: Releases) -> None:
    schedule.begin(START + 0.1)
    told = status(schedule, 0.95)  # still running; 0.2 to 0.8 passed wholly
    assert told.releases == 8
    assert told.missed == 7


def test_counts_stay_over_a_pause_and_the_pause_is_not_counted() -> None:
    timers = Timers({"tick": Timer("tick", 0.1, 0.05)})
    timers.start(START)
    (tick,) = timers
    for k, ends in ((1, 0.12), (2, 0.28)):
        release = tick.begin(START + 0.1 * k + 0.01)
        tick.end(release, START + 0.1 * k + 0.01, START + ends)
    timers.stop(START + 0.29)
    timers.start(START + 5.0)
    (told,) = timers.status(START + 5.05)
    assert (told.releases, told.missed) == (2, 1)
    release = tick.begin(START + 5.1)
    tick.end(release, START + 5.1, START + 5.11)
    (told,) = timers.status(START + 5.12)
    assert (told.releases, told.missed, told.duration.count) == (3, 1, 3)
    assert timers.next_due() == pytest.approx(START + 5.2)


def test_a_pause_after_a_move_is_not_counted_either() -> None:
    timers = Timers({"tick": Timer("tick", 0.1, 0.05)})
    timers.begin_at({"tick": START + 0.04})
    timers.start(START)
    assert timers.next_due() == pytest.approx(START + 0.04)
    timers.stop(START + 0.01)
    timers.start(START + 60.0)
    assert timers.next_due() == pytest.approx(START + 60.1)
    (told,) = timers.status(START + 60.0)
    assert (told.releases, told.missed) == (0, 0)


def test_timers_are_due_at_multiples_of_their_periods_from_a_given_moment() -> None:
    timers = Timers(
        {"slow": Timer("slow", 0.5, None), "tick": Timer("tick", 0.2, None)}
    )
    timers.start(START, elapsed=7.15)
    assert [each.due for each in timers] == pytest.approx([START + 0.35, START + 0.05])


def test_when_timers_are_due_does_not_depend_on_when_their_component_began() -> None:
    """Whatever held up a start, the releases are those of the start before."""
    dues = []
    for began in (0.0, 0.37, 3.91):
        timers = Timers({"tick": Timer("tick", 0.2, None)})
        timers.start(START + began, elapsed=5.05 + began)
        due = timers.next_due()
        assert due is not None
        assert START + began < due <= START + began + 0.2
        dues.append((due - START) / 0.2 % 1.0)
    assert dues == pytest.approx([dues[0]] * 3)


def test_components_are_due_at_moments_of_their_own() -> None:
    names = ("camera", "localiser", "planner", "wheels")
    offsets = [release_offset(each) for each in names]
    assert offsets == [release_offset(each) for each in names]
    assert len(set(offsets)) == len(names)
    assert all(0.0 <= each < 1.0 for each in offsets)
