"""Functions that tasks miss: what stops for lack of them, and what starts again.

A function is there while all components of an architecture that provides it are
placed on computers within reach.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import partial
from itertools import groupby, islice, product

from poise.clock import wall_time
from poise.manage.adaptation.responder import Change
from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.journal import Journal
from poise.manage.migration.transition_run import start_together
from poise.manage.observe.deviations import Deviation
from poise.manage.shortages.free_room import room_for_components
from poise.manage.shortages.suspension import LONGEST, PutAside
from poise.model.policy.policy import LASTS
from poise.model.robot import Architecture


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


CALM = 5.0
"""Nothing must have been wrong for this time before one is taken back [s]."""
_TRY_AGAIN = 2.0
"""When there is no room, that is looked at again after this time [s]; then after twice
as long, up to `LONGEST`, until a computer is lost or back."""
_MOST_CHOICES = 8
"""The most combinations of alternatives of needed functions that are tried."""


class StopWithoutNeeded:
    """Stops what else a task runs that lacks a needed function.

    What is back within moments goes on: architectures with a component on a lost
    computer stay as they are.
    """

    purpose = "stop a task that lacks what it needs"

    def __init__(self, put_aside: PutAside) -> None:
        self._put_aside = put_aside
        self._again_at = 0.0

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return what is stopped, if a needed function is missing."""
        now, robot = situation.now, situation.robot
        if not situation.missing or now < self._again_at:
            return None
        there = {
            n: at for n, at in situation.placement.items() if at not in situation.lost
        }
        functions = robot.functions_of(situation.task)
        stops = [
            a
            for a in robot.whole(there)
            if a.layer == "sequencing" and a.function in functions
        ]
        if not stops:
            return None
        self._again_at = now + _TRY_AGAIN
        where = {c.name: there[c.name] for a in stops for c in a.components}
        why = lacking(situation.task, situation.missing)
        return Change(carry_out=partial(self._put_aside.hold, stops, where, why, now))


class TakeBack:
    """Starts what fits again beside what runs, the highest priority first.

    What runs stays where it is.
    """

    purpose = "start again what was put aside"

    def __init__(self, run: RunningComponents, put_aside: PutAside) -> None:
        self._run = run
        self._put_aside = put_aside
        self._try_at = 0.0
        self._try_again = _TRY_AGAIN
        self._lost: frozenset[str] = frozenset()
        self._calm_since: float | None = None

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return what starts, when nothing has been wrong for a while."""
        now, is_calm = situation.now, not situation.about("replan")
        if situation.lost != self._lost:
            self._lost = situation.lost
            self._try_at, self._try_again = now, _TRY_AGAIN
        if not is_calm or self._calm_since is None:
            self._calm_since = now if is_calm else None
        if self._calm_since is None or now - self._calm_since < CALM:
            return None
        due = self._put_aside.due(now)
        if self._put_aside.take_news():
            self._try_at = now
        if not due or now < self._try_at:
            return None
        choices = self._choices(due, situation.missing)
        if not choices:
            return None
        for architectures in choices:
            names = {c.name for a in architectures for c in a.components}
            if where := room_for_components(situation, names):
                self._try_at, self._try_again = now + _TRY_AGAIN, _TRY_AGAIN
                started = [architecture.name for architecture in architectures]
                what = " and ".join(f"architecture '{name}'" for name in started)
                return Change(
                    why=f"there is room: {what} taken back",
                    facts={"placement": where},
                    carry_out=partial(self._start, started, where, now),
                )
        self._try_at = now + self._try_again
        self._try_again = min(2 * self._try_again, LONGEST)
        return None

    def _choices(
        self, due: list[Architecture], missing: AbstractSet[str]
    ) -> list[Sequence[Architecture]]:
        """Return what may be taken back together, the best first.

        While needed functions are missing, that is nothing but all of them.
        """
        if not missing:
            held = [a for a in due if a.name in self._put_aside.held]
            return [*([held] if held else []), *([each] for each in due)]
        needed = sorted((a for a in due if a.function in missing), key=_function)
        of_each = [list(group) for _, group in groupby(needed, _function)]
        if len(of_each) < len(missing):
            return []
        return [*islice(product(*of_each), _MOST_CHOICES)]

    def _start(self, names: list[str], where: Mapping[str, str], now: float) -> None:
        if start_together(self._run, where):
            self._put_aside.note_started(names, now)
        else:
            self._put_aside.note(names, "it could not be started", now)


def _function(architecture: Architecture) -> str:
    return architecture.function
