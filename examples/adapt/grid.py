"""Finds ways through a map, again and again: work whose size is the map's."""

from __future__ import annotations

import random
from collections import deque

from poise import Component, Message, Published, every, subscribed


class Way(Message):
    """How many steps the shortest way has; -1: there is none."""

    steps: int


class Planner(Component):
    """Searches the shortest way across a map of `size` x `size` cells at 10 Hz."""

    way: Published[Way]

    def configure(self) -> None:
        self.size = int(self.parameters["size"])
        self.chance = random.Random(7)

    @every(0.1, deadline=0.1)
    def search(self) -> None:
        cells = range(self.size)
        walls = {(x, y) for x in cells for y in cells if self.chance.random() < 0.1}
        self.way.publish(Way(shortest(self.size, walls)))


class Follower(Component):
    """Takes the ways."""

    @subscribed(keep=5)
    def way(self, message: Way) -> None:
        self.measure("steps", message.steps)


def shortest(size: int, walls: set[tuple[int, int]]) -> int:
    """Return the steps from one corner to the other; -1: there is no way."""
    begin, end = (0, 0), (size - 1, size - 1)
    steps, queue = {begin: 0}, deque([begin])
    while queue:
        x, y = here = queue.popleft()
        if here == end:
            return steps[here]
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            inside = 0 <= cell[0] < size and 0 <= cell[1] < size
            if inside and cell not in walls and cell not in steps:
                steps[cell] = steps[here] + 1
                queue.append(cell)
    return -1
