"""A chain of three components: what the sink gets shows what became of the relay."""

from __future__ import annotations

from handler_log import HandlerLog

from poise import Component, Message, Published, every, subscribed


class Number(Message):
    """The source counts from 1."""

    value: int


class Source(Component):
    """Publishes 50 numbers a second."""

    numbers: Published[Number]

    def configure(self) -> None:
        self.handlers = HandlerLog(self.name)
        self.sent = 0

    @every(0.02)
    def count(self) -> None:
        with self.handlers.run():
            self.sent += 1
            self.numbers.publish(Number(self.sent))


class Relay(Component):
    """Passes numbers on, and has a timer, as what drives a motor would."""

    relayed: Published[Number]

    def configure(self) -> None:
        self.handlers = HandlerLog(self.name)

    @subscribed(keep=1)
    def numbers(self, message: Number) -> None:
        with self.handlers.run():
            self.relayed.publish(message)

    @every(0.02)
    def drive(self) -> None:
        with self.handlers.run():
            pass


class Sink(Component):
    """Counts what is missing, came twice, or came late."""

    def configure(self) -> None:
        self.handlers = HandlerLog(self.name)
        self.last = self.lost = self.doubled = self.reordered = 0

    @subscribed(keep=1)
    def relayed(self, message: Number) -> None:
        with self.handlers.run():
            if self.last:
                self.lost += max(0, message.value - self.last - 1)
            self.doubled += message.value == self.last
            self.reordered += message.value < self.last
            self.last = max(self.last, message.value)

    @every(0.2)
    def tell(self) -> None:
        for name in ("lost", "doubled", "reordered"):
            self.measure(name, getattr(self, name))
