"""What the robot knows about the household, as sentences of three words in SQLite."""

from __future__ import annotations

import sqlite3
import time

from poise import Component, Message, Provided
from trot.interfaces import Knowledge

FACTS = (
    ("glasses", "is", "table"),
    ("keys", "is", "cupboard"),
    ("remote control", "is", "sofa"),
    ("medicine", "is", "bathroom"),
    ("table", "is at", "on the table in the kitchen"),
    ("cupboard", "is at", "in the cupboard"),
    ("sofa", "is at", "under the sofa"),
    ("bathroom", "is at", "in the bathroom"),
    ("doctor", "comes", "at ten"),
    ("nurse", "comes", "at eight"),
    ("outside", "has", "seven"),
    ("inside", "has", "twenty one"),
)
"""Subject, verb, object."""

_FOLLOW = """
with recursive found(word, verb) as (
  select object, verb from facts where subject = ? and verb = ?
  union all
  select facts.object, facts.verb from facts join found
  on facts.subject = found.word and facts.verb = found.verb || ' at'
) select word from found"""
"""Where a thing is, and where that is."""


class Facts(Message, frozen=True):
    """All facts, for a successor."""

    facts: list[tuple[str, str, str]]


class HouseholdKnowledge(Component):
    """Answers where things are and when people come; learns new facts."""

    knowledge: Provided[Knowledge]

    def configure(self) -> None:
        self._facts = sqlite3.connect(":memory:", check_same_thread=False)
        self._facts.execute("create table facts (subject, verb, object)")
        self._learn(list(FACTS))

    def ask(self, subject: str, verb: str) -> str:
        if (subject, verb) == ("clock", "shows"):
            return time.strftime("%H %M")
        words = self._facts.execute(_FOLLOW, (subject, verb)).fetchall()
        return words[-1][0] if words else ""

    def snapshot(self) -> Facts:
        return Facts(self._facts.execute("select * from facts").fetchall())

    def restore(self, state: Facts) -> None:
        self._facts.execute("delete from facts")
        self._learn(state.facts)

    def cleanup(self) -> None:
        self._facts.close()

    def _learn(self, facts: list[tuple[str, str, str]]) -> None:
        self._facts.executemany("insert into facts values (?, ?, ?)", facts)
