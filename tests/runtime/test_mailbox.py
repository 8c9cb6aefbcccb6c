"""What waits for a component: bounded, and in order."""

from __future__ import annotations

import threading
import time

import pytest

from poise.errors import Timeout
from poise.runtime.connectors.counts import Counts
from poise.runtime.mailbox import Inbox, Mailbox
from poise.runtime.ports import Queue

LIMIT = 20.0


def entries(*numbers: int) -> list[tuple[int, int]]:
    return [(0, number) for number in numbers]


def test_keeps_the_last_and_counts_the_others() -> None:
    inbox = Inbox("scan", Queue("keep", 2))
    one, other = Counts(), Counts()
    by = (one, other, other, other)
    pairs = zip(entries(1, 2, 3, 4), by, strict=True)
    assert [inbox.add(e, 0.0, c) for e, c in pairs] == [True, True, False, False]
    assert inbox.waiting() == entries(3, 4)
    # each connector is told of what came over it: 1 made room for 3, and 2 for 4
    assert (one.drops, other.drops) == (1, 1)


def test_counts_how_long_what_is_taken_has_waited() -> None:
    inbox, counts = Inbox("scan", Queue("keep", 2)), Counts()
    began = time.monotonic()
    for entry in entries(1, 2):
        inbox.add(entry, 0.0, counts)
    inbox.take()
    waited = counts.wait.summary()
    assert waited.count == 1
    assert 0 <= waited.maximum <= time.monotonic() - began


def test_blocks_until_there_is_room() -> None:
    inbox, counts = Inbox("scan", Queue("block", 1)), Counts()
    inbox.add((0, 1), 0.0, Counts())
    waiting = threading.Thread(target=inbox.add, args=((0, 2), LIMIT, counts))
    waiting.start()
    assert inbox.take() == (0, 1)
    waiting.join(LIMIT)
    assert inbox.waiting() == entries(2)
    assert counts.drops == 0


def test_blocks_no_longer_than_the_limit() -> None:
    inbox = Inbox("scan", Queue("block", 2))
    for entry in entries(1, 2):
        inbox.add(entry, 0.0, Counts())
    with pytest.raises(Timeout, match=r"port 'scan' had 2 messages waiting for 0.01 s"):
        inbox.add((0, 3), 0.01, Counts())
    assert inbox.waiting() == entries(1, 2)


def test_takes_nothing_from_an_empty_queue() -> None:
    assert Inbox("scan", Queue()).take() is None


def test_neither_drops_nor_blocks_at_rest() -> None:
    for policy in ("keep", "block"):
        inbox = Inbox("scan", Queue(policy, 1))
        inbox.rest(resting=True)
        for entry in entries(1, 2, 3):
            inbox.add(entry, 0.0, Counts())
        inbox.rest(resting=False)
        assert [inbox.take() for _ in range(3)] == entries(1, 2, 3)


def test_wakes_once_for_every_message_that_waits() -> None:
    mailbox, inbox = Mailbox(), Inbox("scan", Queue("keep", 2))
    for entry in entries(1, 2, 3):
        mailbox.add(inbox, entry, 0.0, Counts())
    assert [mailbox.next(0.0) for _ in range(3)] == [inbox, inbox, None]


def test_serves_ports_in_the_order_of_arrival() -> None:
    mailbox = Mailbox()
    one, two = (Inbox(name, Queue("keep", 5)) for name in ("one", "two"))
    for inbox in (two, one, two):
        mailbox.add(inbox, (0, 0), 0.0, Counts())
    assert [mailbox.next(0.0) for _ in range(3)] == [two, one, two]


def test_a_wake_up_brings_nothing() -> None:
    mailbox = Mailbox()
    mailbox.wake()
    assert mailbox.next(LIMIT) is None
