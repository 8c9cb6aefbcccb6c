"""What is held back: all that was sent, or the newest messages alone."""

from __future__ import annotations

from poise.runtime.connectors.sender import MOST_BUFFERED, MessageBuffer
from poise.runtime.execution.counters import Counts


def filled(counts: Counts, count: int) -> MessageBuffer:
    buffer = MessageBuffer(counts)
    for number in range(count):
        buffer.add((None, number, 0.0))
    return buffer


def taken(buffer: MessageBuffer) -> list[object]:
    return [buffer.pop()[1] for _ in range(len(buffer))]


def test_all_is_held_in_order_and_publishers_wait_for_room() -> None:
    counts = Counts()
    buffer = filled(counts, MOST_BUFFERED - 1)
    assert buffer.has_room()
    buffer.add((None, MOST_BUFFERED - 1, 0.0))
    assert not buffer.has_room()
    assert taken(buffer) == list(range(MOST_BUFFERED))
    assert counts.drops == 0


def test_what_a_subscriber_would_not_keep_is_dropped_and_counted() -> None:
    """Of 0 to 4 the newest two, 3 and 4, are kept; then 5 and 6 take their place."""
    counts = Counts()
    buffer = filled(counts, 5)
    buffer.keep(2)
    assert counts.drops == 3
    buffer.add((None, 5, 0.0))
    buffer.add((None, 6, 0.0))
    assert counts.drops == 5
    assert buffer.has_room()
    assert taken(buffer) == [5, 6]


def test_fewer_messages_than_a_subscriber_keeps_are_all_held() -> None:
    counts = Counts()
    buffer = filled(counts, 2)
    buffer.keep(3)
    assert taken(buffer) == [0, 1]
    assert counts.drops == 0
