"""Components that number all they say, by stream, and log when their handlers run.

One that starts without its state begins another stream.
"""

import random
import secrets
import time
from collections.abc import Mapping
from typing import Protocol

from handler_log import HandlerLog

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
LONGEST = 3.0
"""A worker's handler takes at most so long [s]."""
_STEP = 0.02


class Number(Message):
    """`at`: when it was published [s, by the clock of the machine]."""

    sender: str
    stream: str
    value: int
    at: float


class Stream(Message):
    """What a source said last."""

    name: str
    last: int


class Newest(Message):
    """A sender's newest stream, and when it began."""

    name: str
    since: float


class Streams(Message):
    """What came last, by stream, and what was wrong with it."""

    last: Mapping[str, int]
    born: float
    received: int = 0
    lost: int = 0
    doubled: int = 0
    reordered: int = 0
    beside: int = 0
    newest: Mapping[str, Newest] = {}


class Logged(Component):
    """Logs when its handlers run."""

    def configure(self) -> None:
        self.handlers = HandlerLog(self.name)


class Receiver(Logged):
    """Counts what is missing, came twice, or came late.

    Also what an earlier incarnation of its sender published beside a later one.
    """

    def configure(self) -> None:
        super().configure()
        self.seen = Streams({}, time.time())

    def take(self, number: Number) -> None:
        was = self.seen
        newest = was.newest.get(number.sender, Newest(number.stream, number.at))
        is_beside = number.stream != newest.name and number.at > newest.since
        if number.stream not in was.last and is_beside:
            newest, is_beside = Newest(number.stream, number.at), False
        before = was.last.get(number.stream, number.value - 1)
        last = {**was.last, number.stream: max(before, number.value)}
        self.seen = Streams(
            last=dict(list(last.items())[-MOST_STREAMS:]),
            born=was.born,
            received=was.received + 1,
            lost=was.lost + max(0, number.value - before - 1),
            doubled=was.doubled + (number.value == before),
            reordered=was.reordered + (number.value < before),
            beside=was.beside + is_beside,
            newest={**was.newest, number.sender: newest},
        )

    @every(0.1)
    def tell(self) -> None:
        with self.handlers.run():
            for name in ("born", "received", "lost", "doubled", "reordered", "beside"):
                self.measure(name, getattr(self.seen, name))

    def snapshot(self) -> Streams:
        return self.seen

    def restore(self, state: Streams) -> None:
        self.seen = state


class Sender(Logged):
    """Numbers what it says."""

    def configure(self) -> None:
        super().configure()
        self.stream = Stream(secrets.token_hex(4), 0)

    def next(self) -> Number:
        self.stream = Stream(self.stream.name, self.stream.last + 1)
        now = time.clock_gettime(time.CLOCK_MONOTONIC)
        return Number(self.name, self.stream.name, self.stream.last, now)

    def snapshot(self) -> Stream:
        return self.stream

    def restore(self, state: Stream) -> None:
        self.stream = state


class Source(Sender):
    numbers: Published[Number]

    @every(0.02)
    def say(self) -> None:
        with self.handlers.run():
            self.numbers.publish(self.next())


class Relay(Logged):
    relayed: Published[Number]

    @subscribed(block=1000)
    def numbers(self, message: Number) -> None:
        with self.handlers.run():
            self.relayed.publish(message)


class Worker(Sender):
    """Works for up to `LONGEST` at a time, and publishes what came of it."""

    results: Published[Number]

    @every(4.0)
    def work(self) -> None:
        with self.handlers.run():
            end = time.monotonic() + random.uniform(0, LONGEST)
            while time.monotonic() < end:
                time.sleep(_STEP)
                self.handlers.go_on()
            self.results.publish(self.next())


class Sink(Receiver):
    @subscribed(block=1000)
    def relayed(self, message: Number) -> None:
        with self.handlers.run():
            self.take(message)

    @subscribed(block=1000)
    def results(self, message: Number) -> None:
        with self.handlers.run():
            self.take(message)


class Sensor(Sender):
    readings: Published[Number]

    @every(0.05)
    def read(self) -> None:
        with self.handlers.run():
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
        with self.handlers.run():
            self.take(message)

    @every(0.05)
    def ask(self) -> None:
        with self.handlers.run():
            self.ask_once()

    def ask_once(self) -> None:
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


class Counter(Logged):
    counter: Provided[Counts]

    def configure(self) -> None:
        super().configure()
        self.value = 0

    def count(self) -> int:
        with self.handlers.run():
            self.value += 1
            return self.value

    def snapshot(self) -> Count:
        return Count(self.value)

    def restore(self, state: Count) -> None:
        self.value = state.value
