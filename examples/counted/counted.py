"""Messages and calls that are counted: what is lost, doubled or late shows."""

from __future__ import annotations

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


class Number(Message):
    """Sources count from 1."""

    value: int


class Doubles(Protocol):
    """What `Passer` offers."""

    def double(self, value: int) -> int:
        """Return twice the value."""
        ...


class SourceState(Message):
    """What a source has done."""

    sent: int = 0
    answered: int = 0
    failed: int = 0


class Source(Component):
    """Publishes 200 numbers a second, and asks for every tenth to be doubled."""

    numbers: Published[Number]
    doubles: Required[Doubles]

    def configure(self) -> None:
        self.state = SourceState()

    @every(0.005)
    def produce(self) -> None:
        state = self.state
        sent, answered, failed = state.sent + 1, state.answered, state.failed
        self.numbers.publish(Number(sent))
        if sent % 10 == 0:
            try:
                answered += self.doubles.double(sent) == 2 * sent
            except CallError:
                failed += 1
        self.state = SourceState(sent, answered, failed)

    @every(0.2)
    def tell(self) -> None:
        for name in self.state.__struct_fields__:
            self.measure(name, getattr(self.state, name))

    def snapshot(self) -> SourceState:
        return self.state

    def restore(self, state: SourceState) -> None:
        self.state = state


class PasserState(Message):
    """So much that it takes a while to move."""

    ballast: bytes


class Passer(Component):
    """Passes numbers on, and doubles others."""

    passed: Published[Number]
    doubles: Provided[Doubles]

    def configure(self) -> None:
        self.ballast = bytes(int(self.parameters["ballast"]))

    def double(self, value: int) -> int:
        return 2 * value

    @subscribed(block=2000)
    def numbers(self, message: Number) -> None:
        self.passed.publish(message)

    def snapshot(self) -> PasserState:
        return PasserState(self.ballast)

    def restore(self, state: PasserState) -> None:
        self.ballast = state.ballast


class SinkState(Message):
    """What came, and how."""

    last: int = 0
    received: int = 0
    lost: int = 0
    doubled: int = 0
    reordered: int = 0


class Sink(Component):
    """Counts what is missing, came twice, or came late."""

    def configure(self) -> None:
        self.state = SinkState()

    @subscribed(block=2000)
    def passed(self, message: Number) -> None:
        was, value = self.state, message.value
        self.state = SinkState(
            last=max(was.last, value),
            received=was.received + 1,
            lost=was.lost + max(0, value - was.last - 1),
            doubled=was.doubled + (value == was.last),
            reordered=was.reordered + (value < was.last),
        )

    @every(0.2)
    def tell(self) -> None:
        for name in self.state.__struct_fields__:
            self.measure(name, getattr(self.state, name))

    def snapshot(self) -> SinkState:
        return self.state

    def restore(self, state: SinkState) -> None:
        self.state = state
