"""Every choice of one run: drawn from its seed, and recorded for a replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, log
from random import Random
from typing import Literal

Stream = Literal["schedule", "network", "faults", "clients", "components"]
"""What a choice is about. One more draw in a stream changes no other stream."""
STREAMS: tuple[Stream, ...] = Stream.__args__  # type: ignore[attr-defined]


class Choices:
    """Draws the choices of a run.

    `seed`: the same seed draws the same choices, on any machine.
    `recorded`: stream -> the first draws of an earlier run, each in [0, 1); when these
    are used up, the seed draws.
    `made`: stream -> all draws so far. What the code under test draws itself comes from
    generators of its processes (`random`), and is not recorded.
    """

    def __init__(
        self, seed: int, recorded: Mapping[str, Sequence[float]] | None = None
    ) -> None:
        self.seed = seed
        self.made: dict[str, list[float]] = {stream: [] for stream in STREAMS}
        self._recorded = recorded or {}
        self._random: dict[str, Random] = {}
        self._next = {stream: self.random(stream).random for stream in STREAMS}

    def random(self, stream: str) -> Random:
        """Return a generator of its own for a stream, such as a process's."""
        if stream not in self._random:
            # a text is hashed by SHA-512, whatever PYTHONHASHSEED says
            self._random[stream] = Random(f"{self.seed}/{stream}")  # noqa: S311
        return self._random[stream]

    def recorded(self, stream: str) -> Sequence[float]:
        """Return the first draws of an earlier run, for one that draws them itself."""
        return self._recorded.get(stream, ())

    def draw(self, stream: Stream) -> float:
        """Return the next draw of a stream, in [0, 1)."""
        made, value = self.made[stream], self._next[stream]()
        if self._recorded:
            recorded = self._recorded.get(stream, ())
            if len(made) < len(recorded):
                value = recorded[len(made)]
        made.append(value)
        return value

    def among(self, stream: Stream, count: int) -> int:
        """Return one of the numbers from 0 to `count` - 1; 0 when all draws are 0."""
        return int(self.draw(stream) * count)

    def between(self, stream: Stream, low: float, high: float) -> float:
        """Return a number from `low` to `high`."""
        return low + (high - low) * self.draw(stream)

    def pause(self, probability: float) -> float:
        """Return how often something does not happen until it does."""
        draw = self.draw("schedule")
        return log(draw) // log(1 - probability) if draw else inf

    def happens(self, stream: Stream, probability: float) -> bool:
        """Return whether something happens; not when all draws are 0."""
        return self.draw(stream) > 1 - probability
