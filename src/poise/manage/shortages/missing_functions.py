"""Which functions of a task are missing, and whether it goes on without them.

A function is there while all components of an architecture that provides it are
placed on computers within reach.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Set as AbstractSet

from poise.clock import wall_time
from poise.manage.adaptation.situation import Situation
from poise.manage.journal import Journal
from poise.manage.observe.deviations import Deviation
from poise.model.policy.policy import LASTS


class Needs:
    """The functions that a task needs or uses, and since when some are missing [s]."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._since: dict[str, float] = {}
        self._said: dict[str, Deviation] = {}

    def look(self, situation: Situation, now: float) -> AbstractSet[str]:
        """Say what is missing or back; return what is needed and is missing.

        What comes back within moments, as by a fail-over, does not count.
        """
        missing, task = missing_functions(situation), situation.task
        needed = {n for t in situation.robot.tasks if t.name == task for n in t.needs}
        if needed & self._said.keys() & missing:  # it has stopped the others
            missing = (missing & needed) | self._said.keys() & missing
        self._since = {name: self._since.get(name, now) for name in missing}
        for name in sorted(self._said.keys() - missing):
            del self._said[name]
            text = f"function '{name}' of task '{task}' is back"
            self._journal.note("right", text)
        lasting = {n for n, since in self._since.items() if now - since >= LASTS}
        for name in sorted(lasting - self._said.keys()):
            what = f"task '{task}' goes on without function '{name}'"
            if name in needed:
                what = f"{lacking(task, {name})}"
            self._said[name] = Deviation(what=what, computer="", since=wall_time())
            self._journal.note("wrong", what)
        return lasting & needed

    def deviations(self) -> tuple[Deviation, ...]:
        """Return what is missing; from any thread."""
        return tuple(self._said.copy().values())


def lacking(task: str, functions: Iterable[str]) -> str:
    """Return why a task stops, for people."""
    names = " and ".join(f"'{name}'" for name in sorted(functions))
    return f"task '{task}' needs function {names}, which is missing"


def missing_functions(situation: Situation) -> AbstractSet[str]:
    """Return the functions of the task that nothing provides now."""
    there = {n for n, at in situation.placement.items() if at not in situation.lost}
    provided = {a.function for a in situation.robot.whole(there)}
    return {*situation.robot.functions_of(situation.task)} - provided
