"""Components that number all they say, by stream: one that began anew is another."""

import secrets
import time
from collections.abc import Mapping
from typing import Protocol

from poise import (
    CallError,
    Component,
    Message,
    Provided,
    Published,
    Required,
    every,
    subscribed,
)

MOST_STREAMS = 50
"""A receiver remembers so many streams."""


class Number(Message):
    stream: str
    value: int


class Stream(Message):
    """What a source said last."""

    name: str
    last: int


class Streams(Message):
    """What came last, by stream, and what was wrong with it."""

    last: Mapping[str, int]
    born: float
    received: int = 0
    lost: int = 0
    doubled: int = 0
    reordered: int = 0


class Receiver(Component):
    """Counts what is missing, came twice, or came late."""

    def configure(self) -> None:
        self.seen = Streams({}, time.time())

    def take(self, number: Number) -> None:
        was = self.seen
        before = was.last.get(number.stream, number.value - 1)
        last = {**was.last, number.stream: max(before, number.value)}
        self.seen = Streams(
            last=dict(list(last.items())[-MOST_STREAMS:]),
            born=was.born,
            received=was.received + 1,
            lost=was.lost + max(0, number.value - before - 1),
            doubled=was.doubled + (number.value == before),
            reordered=was.reordered + (number.value < before),
        )

    @every(0.1)
    def tell(self) -> None:
        for name in ("born", "received", "lost", "doubled", "reordered"):
            self.measure(name, getattr(self.seen, name))

    def snapshot(self) -> Streams:
        return self.seen

    def restore(self, state: Streams) -> None:
        self.seen = state


class Sender(Component):
    """Numbers what it says."""

    def configure(self) -> None:
        self.stream = Stream(secrets.token_hex(4), 0)

    def next(self) -> Number:
        self.stream = Stream(self.stream.name, self.stream.last + 1)
        return Number(self.stream.name, self.stream.last)

    def snapshot(self) -> Stream:
        return self.stream

    def restore(self, state: Stream) -> None:
        self.stream = state


class Source(Sender):
    numbers: Published[Number]

    @every(0.02)
    def say(self) -> None:
        self.numbers.publish(self.next())


class Relay(Component):
    relayed: Published[Number]

    @subscribed(block=1000)
    def numbers(self, message: Number) -> None:
        self.relayed.publish(message)


class Sink(Receiver):
    @subscribed(block=1000)
    def relayed(self, message: Number) -> None:
        self.take(message)


class Sensor(Sender):
    readings: Published[Number]

    @every(0.05)
    def read(self) -> None:
        self.readings.publish(self.next())


class Counts(Protocol):
    def count(self) -> int: ...


class Caller(Receiver):
    counter: Required[Counts]

    def configure(self) -> None:
        super().configure()
        self.answered = self.refused = self.fell = self.most = 0

    @subscribed(block=1000)
    def readings(self, message: Number) -> None:
        self.take(message)

    @every(0.05)
    def ask(self) -> None:
        try:
            count = self.counter.count()
        except CallError:
            self.refused += 1
            return
        self.answered += 1
        # a counter that began anew, or from a checkpoint, has fallen behind
        self.fell = max(self.fell, self.most + 1 - count)
        self.most = count
        for name in ("answered", "refused", "fell"):
            self.measure(name, getattr(self, name))


class Count(Message):
    value: int


class Counter(Component):
    counter: Provided[Counts]

    def configure(self) -> None:
        self.value = 0

    def count(self) -> int:
        self.value += 1
        return self.value

    def snapshot(self) -> Count:
        return Count(self.value)

    def restore(self, state: Count) -> None:
        self.value = state.value
