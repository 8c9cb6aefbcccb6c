"""Which timers miss their deadlines, seen over time."""

from __future__ import annotations

from poise.manage.observe.chains import DeadlineMisses, is_late
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerStatus,
    Summary,
    TimerStatus,
)


def status(period: float, releases: int, missed: int) -> dict[str, AgentStatus]:
    timer = TimerStatus(
        name="tick",
        period=period,
        deadline=period,
        releases=releases,
        missed=missed,
        lateness=Summary(),
        duration=Summary(),
    )
    component = ComponentStatus(name="a", state="active", timers=(timer,))
    container = ContainerStatus(name="c", pid=1, components=(component,))
    return {
        "left": AgentStatus(
            computer="left", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
        )
    }


def test_a_slow_timer_stays_late_between_its_releases() -> None:
    """It is due every 2 s, and always late; there is a look every 0.2 s."""
    misses, late = DeadlineMisses(), []
    for tick in range(100):
        now = tick * 0.2
        count = int(now / 2)
        found = misses.measure(status(2.0, count, count), now)
        late.append(any(each.late for each in found))
    assert not any(late[:10])
    assert all(late[10:])


def test_what_was_missed_long_ago_does_not_count() -> None:
    misses = DeadlineMisses()
    misses.measure(status(0.1, 10, 0), 0.0)
    (found,) = misses.measure(status(0.1, 20, 9), 1.0)
    assert (found.released, found.missed, found.over) == (10, 9, 1.0)
    (found,) = misses.measure(status(0.1, 30, 9), 2.0)
    assert (found.released, found.missed) == (10, 0)


def test_only_releases_of_the_last_second_count() -> None:
    """Statuses come once a second, and at once when a deadline was missed."""
    misses = DeadlineMisses()
    misses.measure(status(0.1, 0, 0), 0.0)
    misses.measure(status(0.1, 10, 0), 1.0)
    misses.measure(status(0.1, 18, 1), 1.8)
    (found,) = misses.measure(status(0.1, 19, 2), 1.9)
    assert (found.released, found.missed) == (10, 2)
    assert found.late
    (found,) = misses.measure(status(0.1, 19, 2), 2.7)  # no status came meanwhile
    assert (found.released, found.missed) == (9, 2)


def test_two_statuses_that_come_within_one_look_count_as_one() -> None:
    misses = DeadlineMisses()
    misses.measure(status(0.1, 4, 0), 0.5)
    assert not misses.measure(status(0.1, 5, 1), 0.5)
    (found,) = misses.measure(status(0.1, 15, 2), 1.5)
    assert (found.released, found.missed) == (10, 1)
    (found,) = misses.measure(status(0.1, 16, 3), 1.5)
    assert (found.released, found.missed) == (11, 2)


def test_a_single_miss_among_others_is_no_sign() -> None:
    assert not is_late(5, missed=1)
