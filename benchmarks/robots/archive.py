"""A component whose state is 50 MB, of which a little changes all the time."""

import random
import time
from collections.abc import Mapping
from typing import Protocol

from poise import CallError, Component, Message, Provided, Required, every

PAGE = 1_000
"""Size of a page [bytes]."""
NUM_PAGES = 50_000


class Book(Message):
    pages: bytes
    written: int


class Changes(Message):
    """What changed since the last look, by the number of the page."""

    pages: Mapping[int, bytes]
    written: int


class Pages(Protocol):
    def read(self, number: int) -> bytes: ...

    def num_written(self) -> int: ...


class Archive(Component):
    """Writes a hundred pages a second, and remembers which."""

    pages: Provided[Pages]

    def configure(self) -> None:
        self.book = bytearray(PAGE * NUM_PAGES)
        self.written = 0
        self.changed: set[int] = set()

    @every(0.01)
    def write(self) -> None:
        number = random.randrange(NUM_PAGES)
        self.written += 1
        page = self.written.to_bytes(8) * (PAGE // 8)
        self.book[number * PAGE : (number + 1) * PAGE] = page
        self.changed.add(number)

    def read(self, number: int) -> bytes:
        return bytes(self.book[number * PAGE : (number + 1) * PAGE])

    def num_written(self) -> int:
        return self.written

    def snapshot(self) -> Book:
        self.changed.clear()
        return Book(bytes(self.book), self.written)

    def restore(self, state: Book) -> None:
        self.book = bytearray(state.pages)
        self.written = state.written

    def snapshot_delta(self) -> Changes:
        pages = {number: self.read(number) for number in self.changed}
        self.changed.clear()
        return Changes(pages, self.written)

    def restore_delta(self, delta: Changes) -> None:
        for number, page in delta.pages.items():
            self.book[number * PAGE : (number + 1) * PAGE] = page
        self.written = delta.written


class Reader(Component):
    """Asks for pages; what was written must never become less."""

    pages: Required[Pages]

    def configure(self) -> None:
        self.asked = self.refused = self.wrong = self.last = 0

    @every(0.02)
    def look(self) -> None:
        began = time.monotonic()
        self.asked += 1
        try:
            self.pages.read(self.asked % NUM_PAGES)
            written = self.pages.num_written()
        except CallError:
            self.refused += 1
        else:
            self.wrong += written < self.last
            self.last = written
        self.measure("waited", time.monotonic() - began)
        for name in ("asked", "refused", "wrong"):
            self.measure(name, getattr(self, name))
