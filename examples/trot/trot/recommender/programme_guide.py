"""Knows what is on television, and what it is about; SQLite finds it."""

from __future__ import annotations

import sqlite3

from poise import Component, Provided
from trot.interfaces import Guide
from trot.messages import Programme
from trot.recommender.audience import PROGRAMMES, SLOT, Audience, on_air

GENRES = ("News", "Crime", "Music", "Nature", "Sport", "Comedy", "History", "Cookery")


class ProgrammeGuide(Component):
    """Answers what is on the air now, with the shares of genres of each programme."""

    guide: Provided[Guide]

    def configure(self) -> None:
        genres = Audience().genres
        self._guide = sqlite3.connect(":memory:", check_same_thread=False)
        self._guide.execute(
            "create table programmes (number primary key, title, genres)"
        )
        self._guide.execute("create table air (slot, number)")
        self._guide.execute("create index slots on air (slot)")
        self._guide.executemany(
            "insert into programmes values (?, ?, ?)",
            [
                (n, f"{GENRES[genres[n].argmax()]} {n}", genres[n].tobytes())
                for n in range(PROGRAMMES)
            ],
        )
        self._last = -1

    def on_air(self) -> list[Programme]:
        slot = int(self.clock.now() // SLOT)
        if slot != self._last:
            rows = [(slot, int(number)) for number in on_air(slot)]
            self._guide.execute("delete from air")
            self._guide.executemany("insert into air values (?, ?)", rows)
            self._last = slot
        found = self._guide.execute(
            "select number, title, genres from programmes join air using (number) "
            "where slot = ? order by number",
            (slot,),
        )
        return [Programme(number, title, about, slot) for number, title, about in found]

    def cleanup(self) -> None:
        self._guide.close()
