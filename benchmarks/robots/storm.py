"""The components of the storm: every message is numbered, at both ends."""

from pathlib import Path
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
    value: int


class Checks(Protocol):
    def double(self, value: int) -> int: ...


class Halt(Message):
    """No more numbers, please."""


class Conductor(Component):
    """Halts the producer once its file is there; it does not move."""

    halt: Published[Halt]

    @every(0.1)
    def look(self) -> None:
        if Path(self.device("halt")).exists():
            self.halt.publish(Halt())


class ProducerState(Message):
    sent: int
    asked: int
    answered: int
    refused: int


class Producer(Component):
    """Publishes 2,000 numbers a second and asks for every tenth to be doubled."""

    numbers: Published[Number]
    checks: Required[Checks]

    def configure(self) -> None:
        self.state = ProducerState(0, 0, 0, 0)
        self.is_halted = False

    @subscribed(block=1)
    def halt(self, _message: Halt) -> None:
        self.is_halted = True

    @every(0.005)
    def produce(self) -> None:
        if self.is_halted:
            return
        sent, asked, answered, refused = (
            self.state.sent,
            self.state.asked,
            self.state.answered,
            self.state.refused,
        )
        for _ in range(10):
            sent += 1
            self.numbers.publish(Number(sent))
        asked += 1
        try:
            answered += self.checks.double(sent) == 2 * sent
        except CallError:
            refused += 1
        self.state = ProducerState(sent, asked, answered, refused)

    @every(0.1)
    def tell(self) -> None:
        for name in self.state.__struct_fields__:
            self.measure(name, getattr(self.state, name))

    def snapshot(self) -> ProducerState:
        return self.state

    def restore(self, state: ProducerState) -> None:
        self.state = state


class RelayState(Message):
    padding: bytes


class Relay(Component):
    """Passes on what it gets; its state is 1 KB."""

    relayed: Published[Number]

    @subscribed(block=4000)
    def numbers(self, message: Number) -> None:
        self.relayed.publish(message)

    def snapshot(self) -> RelayState:
        return RelayState(bytes(1024))

    def restore(self, state: RelayState) -> None:
        assert len(state.padding) == 1024


class ConsumerState(Message):
    last: int
    received: int
    lost: int
    doubled: int
    reordered: int


class Consumer(Component):
    """Counts what is missing, came twice, or came late."""

    checks: Provided[Checks]

    def configure(self) -> None:
        self.state = ConsumerState(0, 0, 0, 0, 0)

    def double(self, value: int) -> int:
        return 2 * value

    @subscribed(block=4000)
    def relayed(self, message: Number) -> None:
        was, value = self.state, message.value
        self.state = ConsumerState(
            last=max(was.last, value),
            received=was.received + 1,
            lost=was.lost + max(0, value - was.last - 1),
            doubled=was.doubled + (value == was.last),
            reordered=was.reordered + (value < was.last),
        )

    @every(0.1)
    def tell(self) -> None:
        for name in self.state.__struct_fields__:
            self.measure(name, getattr(self.state, name))

    def snapshot(self) -> ConsumerState:
        return self.state

    def restore(self, state: ConsumerState) -> None:
        self.state = state
