"""A person who talks to the robot, and notices what comes of it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trot.packets import SAMPLE_RATE, Screen
from trot.world.record import recorded

PAUSE = 2.0
"""[s] between the end of a sentence and the next one."""

FIRST = 1.0
"""[s] after somebody has begun to listen."""

PATIENCE = 1.8
"""[s] An answer that begins later is none."""

EXPECTED = {
    "put the cup": r"cup .* {last}",
    "what is on": r"this is what",
    "where are my glasses": r"glasses .* table",
    "where is the remote": r"remote control .* sofa",
    "what is the time": r"it is \w+",
    "how warm": r"degrees",
    "when does the doctor": r"doctor comes",
    "good morning": r"good morning",
    "thank you": r"welcome",
}
"""Sentences' beginnings, and what a good answer has in it."""


class Asked:
    """A sentence, and what the robot understood and said to it."""

    def __init__(self, sentence: str, ends: float) -> None:
        self.sentence, self.ends = sentence, ends
        self.heard = self.answer = ""
        self.answered: float | None = None

    @property
    def word_errors(self) -> int:
        """Words that the robot missed, added or took for others."""
        return word_errors(self.sentence.split(), self.heard.split())

    @property
    def is_answered(self) -> bool:
        """Whether the robot said in time what one would expect."""
        for begins, pattern in EXPECTED.items():
            if self.sentence.startswith(begins):
                last = self.sentence.split()[-1]
                wanted = re.search(pattern.format(last=last), self.answer.lower())
                return self.answered is not None and wanted is not None
        return False


class Person:
    """Says a sentence every few seconds, in an order that the seed decides."""

    def __init__(self, seed: int = 0) -> None:
        self._known = recorded()
        chance = np.random.default_rng(seed)
        self._order: Iterator[int] = cycle(_mixed(self._known, chance))
        self._begins = -1.0
        self.asked: list[Asked] = []

    def speak(self, now: float, *, listens: bool) -> NDArray[np.int16] | None:
        """Return the samples of a sentence that begins `now` [s]; mostly none does.

        The first one waits until the robot `listens`.
        """
        if self._begins < 0 and listens:
            self._begins = now + FIRST
        if not 0 <= self._begins <= now:
            return None
        sentence, samples = self._known[next(self._order)]
        ends = now + len(samples) / SAMPLE_RATE
        self.asked.append(Asked(sentence, ends))
        self._begins = ends + PAUSE
        return samples

    def read(self, screen: Screen) -> None:
        """See what the robot shows that it understood and said."""
        if self.asked and screen.stamp > self.asked[-1].ends:
            self.asked[-1].heard, self.asked[-1].answer = screen.heard, screen.said

    def hear(self, now: float) -> None:
        """Hear that the robot speaks `now` [s]."""
        waits = self.asked and self.asked[-1].answered is None
        if waits and 0 < now - self.asked[-1].ends < PATIENCE:
            self.asked[-1].answered = now - self.asked[-1].ends

    @property
    def asked_for_television(self) -> float:
        """When the person last asked what is on [s]; 0 when never."""
        asked = [a.ends for a in self.asked if a.sentence.startswith("what is on")]
        return asked[-1] if asked else 0.0

    def result(self, now: float) -> dict[str, Any]:
        """Return how well the robot understood, and how long answers took [s]."""
        asked = [each for each in self.asked if now > each.ends + PATIENCE]
        words = sum(len(each.sentence.split()) for each in asked)
        times = [each.answered for each in asked if each.answered is not None]
        return {
            "sentences": len(asked),
            "answered": sum(each.is_answered for each in asked),
            "word_error_rate": (
                round(sum(e.word_errors for e in asked) / words, 3) if words else None
            ),
            "answer_seconds": round(float(np.median(times)), 3) if times else None,
            "conversation": [
                {"said": each.sentence, "heard": each.heard, "answer": each.answer}
                for each in asked
            ],
        }


def _mixed(
    known: list[tuple[str, NDArray[np.int16]]], chance: np.random.Generator
) -> list[int]:
    """Return the sentences' numbers: in turn one for arm, television and the rest."""
    kinds: list[list[int]] = [[], [], []]
    for number in chance.permutation(len(known)).tolist():
        sentence = known[number][0]
        is_of = [sentence.startswith(words) for words in ("put", "what is on", "")]
        kinds[is_of.index(True)].append(number)
    rest = kinds.pop()
    pairs = zip(cycle(kinds[0]), cycle(kinds[1]), rest, strict=False)
    return [number for three in pairs for number in three]


def word_errors(said: list[str], heard: list[str]) -> int:
    """Return how many words must be put in, left out or changed (Levenshtein)."""
    row = list(range(len(heard) + 1))
    for number, word in enumerate(said, 1):
        above, row = row, [number]
        for place, other in enumerate(heard):
            change = above[place] + (word != other)
            row.append(min(change, above[place + 1] + 1, row[place] + 1))
    return row[-1]
