"""Rates, sizes and ages of what a publisher sends."""

from __future__ import annotations

import pytest

from poise.session.ros2_import.graph_records import Flow, PublisherCount, stamp_of

SECOND = 1_000_000_000


def test_the_rate_counts_messages_that_came_between_two_looks() -> None:
    count = PublisherCount()
    for number in (5, 6, 50, 55):  # 50 messages in 10 s, of which 4 were looked at
        count.count(1000 + number, number, (number - 5) * SECOND // 5)
    flow = count.flow("/camera", seconds=30.0)
    assert (flow.rate, flow.size) == (5.0, 1029.0)


def test_few_messages_are_counted_over_the_whole_time() -> None:
    count = PublisherCount()
    count.count(10, 1, 0)
    count.count(10, 2, SECOND // 1000)
    assert count.flow("/map", seconds=20.0).rate == 0.1


def test_ages_are_those_of_stamps_by_this_clock() -> None:
    count = PublisherCount()
    count.count(10, 1, 0)
    for seconds in (1, 2, 3, 4, 5):
        count.count_stamp(100 * SECOND - seconds * SECOND, 100 * SECOND)
    count.count_stamp(7, 100_000 * SECOND)  # simulated time
    age = count.flow("/scan", 1.0).age
    assert age is not None
    assert age.median == 3.0
    assert age.p99 == pytest.approx(4.96)


def test_a_flow_without_stamps_has_no_age() -> None:
    count = PublisherCount()
    count.count(10, 1, 0)
    assert count.flow("/x", 10.0) == Flow(node="/x", rate=0.1, size=10.0)


@pytest.mark.parametrize(("flag", "order"), [(1, "little"), (0, "big")])
def test_reads_the_stamp_of_a_serialized_message(flag: int, order: str) -> None:
    words = [(3).to_bytes(4, order), (5).to_bytes(4, order)]  # type: ignore[arg-type]
    assert stamp_of(bytes([0, flag, 0, 0]) + b"".join(words)) == 3 * SECOND + 5
