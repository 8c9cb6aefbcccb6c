"""Two components: one counts, the other prints."""

from poise import Component, Message, Published, every, subscribed


class Count(Message):
    value: int


class Counter(Component):
    count: Published[Count]

    def configure(self) -> None:
        self.value = 0

    @every(0.1, deadline=0.1)
    def tick(self) -> None:
        self.value += 1
        self.count.publish(Count(self.value))


class Printer(Component):
    @subscribed(keep=10)
    def count(self, message: Count) -> None:
        if message.value % 10 == 0:
            print(f"{self.name} has {message.value}")
