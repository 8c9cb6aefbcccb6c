"""What waits for a component: bounded, and in order."""

from __future__ import annotations

import time

import pytest

from poise.runtime._calls import ComponentCounters
from poise.runtime.component.ports import Queue
from poise.runtime.execution import mailbox as module
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.mailbox import Feed, Mailbox, PortQueue

LIMIT = 20.0


def inbox_of(queue: Queue) -> PortQueue:
    return PortQueue("scan", queue, lambda _: None, ComponentCounters())


def feed(inbox: PortQueue) -> Feed:
    return Feed(inbox, Counts())


def put(feed: Feed, *numbers: int) -> None:
    for number in numbers:
        feed.put((0, number))


def waiting(inbox: PortQueue) -> list[int]:
    return [value for _, value in inbox.waiting()]


def test_keeps_the_last_and_tells_each_connector_what_it_lost() -> None:
    inbox = inbox_of(Queue("keep", 2))
    one, other = feed(inbox), feed(inbox)
    put(one, 1)
    put(other, 2, 3, 4)  # 3 takes the place of 1, and 4 that of 2
    assert waiting(inbox) == [3, 4]
    assert (one.counts.drops, other.counts.drops) == (1, 1)
    assert one.room() is None


def test_what_comes_for_a_failed_component_is_lost_and_no_job() -> None:
    class Asked(ComponentCounters):
        jobs = 0

        def note_asked(self) -> None:
            self.jobs += 1

    counters, counts = Asked(), Counts()
    mailbox = Mailbox({"scan": Queue("block", 1)}, counters)
    scans = mailbox.feed("scan", counts)
    put(scans, 1)
    mailbox.close()
    assert (counts.drops, mailbox.is_empty(), scans.has_room()) == (1, True, True)
    put(scans, 2, 3)
    assert (counts.drops, mailbox.is_empty(), counters.jobs) == (3, True, 1)


def test_counts_how_long_what_is_taken_has_waited() -> None:
    inbox = inbox_of(Queue("keep", 2))
    one = feed(inbox)
    began = time.monotonic()
    put(one, 1, 2)
    inbox.pop()
    waited = one.counts.wait.summary()
    assert waited.count == 1
    assert 0 <= waited.maximum <= time.monotonic() - began


def test_has_room_of_its_own_for_every_connector() -> None:
    inbox = inbox_of(Queue("block", 2))
    one, other = feed(inbox), feed(inbox)
    put(one, 1, 2)
    assert (one.room(), other.room()) == (0, 2)
    assert not one.has_room()
    put(other, 3)
    assert other.room() == 1


def test_tells_whoever_waits_that_there_is_room() -> None:
    inbox = inbox_of(Queue("block", 1))
    one = feed(inbox)
    told: list[int | None] = []
    one.on_room = lambda: told.append(one.room())
    put(one, 1)
    assert told == []
    assert inbox.pop() == (0, 1)
    assert told == [1]


def test_takes_what_was_held_and_drops_what_nobody_may_send(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A source sends at once what it held during a move, whatever room there is."""
    monkeypatch.setattr(module, "MOST_AHEAD", 3)
    inbox = inbox_of(Queue("block", 1))
    one = feed(inbox)
    put(one, 1, 2, 3, 4, 5)
    assert waiting(inbox) == [1, 2, 3, 4]
    assert (one.room(), one.counts.drops) == (0, 1)


def test_takes_nothing_from_an_empty_queue() -> None:
    assert inbox_of(Queue()).pop() is None


def test_neither_drops_nor_lets_wait_at_rest() -> None:
    for policy in ("keep", "block"):
        inbox = inbox_of(Queue(policy, 1))
        one = feed(inbox)
        inbox.set_unbounded(unbounded=True)
        for number in (1, 2, 3):
            assert one.has_room()
            put(one, number)
        inbox.set_unbounded(unbounded=False)
        assert [inbox.pop() for _ in range(3)] == [(0, 1), (0, 2), (0, 3)]


def test_tells_whoever_waits_when_it_comes_to_rest() -> None:
    inbox = inbox_of(Queue("block", 1))
    one = feed(inbox)
    put(one, 1)
    told: list[int | None] = []
    one.on_room = lambda: told.append(one.room())
    inbox.set_unbounded(unbounded=True)
    assert told == [1]


def ports_that_wake(mailbox: Mailbox, times: int) -> list[str | None]:
    found = (mailbox.work(0.0) for _ in range(times))
    return [inbox.port if isinstance(inbox, PortQueue) else None for inbox in found]


def test_wakes_once_for_every_message_that_waits() -> None:
    mailbox = Mailbox({"scan": Queue("keep", 2)}, ComponentCounters())
    put(mailbox.feed("scan", Counts()), 1, 2, 3)
    assert ports_that_wake(mailbox, 3) == ["scan", "scan", None]


def test_serves_ports_in_the_order_of_arrival() -> None:
    queues = dict.fromkeys(("one", "two"), Queue("keep", 5))
    mailbox = Mailbox(queues, ComponentCounters())
    for port in ("two", "one", "two"):
        put(mailbox.feed(port, Counts()), 0)
    assert ports_that_wake(mailbox, 3) == ["two", "one", "two"]


def test_a_wake_up_brings_nothing() -> None:
    mailbox = Mailbox({}, ComponentCounters())
    mailbox.wake()
    assert mailbox.work(LIMIT) is None
