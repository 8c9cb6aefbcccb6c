"""Architectures that do not run because not all fits: put aside, and taken back.

What is not running is read from the placement, so that a manager that takes over knows
it, too.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

from msgspec import Struct

from poise.errors import RobotError, UsageError
from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.room import placed_beside
from poise.manage.migration.transition import TransitionStep
from poise.manage.migration.transition_run import start_together, transit
from poise.manage.observe.deviations import Deviation
from poise.manage.run import Run
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Architecture, Robot
from poise.units import quoted

FIRST = 10.0
"""An architecture stays aside for this time at least [s]; twice as long each time."""
LONGEST = 300.0
"""It never has to stay aside for longer [s]."""
FORGET_AFTER = 600.0
"""After so long at work [s] it counts as put aside for the first time again."""
CALM = 5.0
"""Nothing must have been wrong for this time before one is taken back [s]."""
_TRY_AGAIN = 2.0
"""When there is no room, that is looked at again after this time [s]; then after twice
as long, up to `LONGEST`, until a computer is lost or back."""


class _Aside(Struct):
    """Why an architecture does not run.

    Parameters
    ----------
    since
        [s since 1970].
    """

    why: str
    since: float


class PutAside:
    """What a robot's task needs, but does not run. Times are those of one clock [s].

    Parameters
    ----------
    why
        Why architectures do not run from the start on.
    """

    def __init__(self, run: Run, task: str, why: str = "") -> None:
        self._run = run
        self._task = task
        self._why = why
        self._known: dict[str, _Aside] = {}
        self._stays: dict[str, tuple[float, float]] = {}
        self._try_at = 0.0
        self._try_again = _TRY_AGAIN
        self._lost: frozenset[str] = frozenset()
        self._calm_since: float | None = None

    def put(
        self, names: Iterable[str], why: str, now: float, *, force: bool = False
    ) -> bool:
        """Stop architectures; return whether that went well.

        Their state is lost.

        Parameters
        ----------
        why
            A clause for people: "container 'camera' crashes again and again".
        force
            Whether also reactive and deliberative ones are; only people may ask so.

        Raises
        ------
        UsageError
            There is no such architecture, it does not run, or its layer stays as it is.
        """
        run, names = self._run, tuple(names)
        components: dict[str, str] = {}
        for name in names:
            architecture = _architecture(run.robot, name)
            if architecture.layer != "sequencing" and not force:
                raise UsageError(
                    f"architecture '{name}' is in the {architecture.layer} layer, "
                    "which Poise never puts aside"
                )
            here = {
                c.name: run.placed[c.name].computer
                for c in architecture.components
                if c.name in run.placed
            }
            if not here:
                raise UsageError(f"architecture '{name}' does not run")
            components |= here
        report = transit(
            run,
            tuple(
                TransitionStep(kind="stop", component=component, source=computer)
                for component, computer in sorted(components.items())
            ),
        )
        if report.committed:
            self.note(names, why, now)
        return report.committed

    def note(self, names: Iterable[str], why: str, now: float) -> None:
        """Remember and say that architectures were stopped."""
        for name in names:
            until, stay = self._stays.get(name, (now, FIRST / 2))
            stay = FIRST if now - until >= FORGET_AFTER else min(2 * stay, LONGEST)
            self._stays[name] = now + stay, stay
            self._add(name, why)

    def look(self) -> None:
        """Note what does not run, and what runs again."""
        aside = {each.name: each.function for each in self._aside()}
        for name in self._known.keys() - aside.keys():
            del self._known[name]
            self._run.journal.note("right", f"architecture '{name}' runs again")
        known = {aside[name] for name in self._known}
        for name, function in aside.items():
            if function not in known:
                known.add(function)
                self._add(name, self._why or "it does not run")

    def deviations(self) -> tuple[Deviation, ...]:
        """Return what is aside; from any thread."""
        return tuple(
            Deviation(what=_sentence(name, each.why), computer="", since=each.since)
            for name, each in sorted(self._known.copy().items())
        )

    def take_back(self, facts: Facts, now: float, *, is_calm: bool) -> bool:
        """Start what fits again beside what runs, the highest priority first.

        What runs stays where it is. Returns whether something was started.

        Parameters
        ----------
        is_calm
            Whether nothing is wrong now.
        """
        if facts.lost != self._lost:
            self._lost = facts.lost
            self._try_at, self._try_again = now, _TRY_AGAIN
        if not is_calm or self._calm_since is None:
            self._calm_since = now if is_calm else None
        if self._calm_since is None or now - self._calm_since < CALM:
            return False
        due = [a for a in self._aside() if self._is_due(a.name, now)]
        if not due or now < self._try_at:
            return False
        for architecture in due:
            if where := _room_for(facts, architecture):
                return self._start(architecture, where, now)
        self._try_at = now + self._try_again
        self._try_again = min(2 * self._try_again, LONGEST)
        return False

    def _start(
        self, architecture: Architecture, where: Mapping[str, str], now: float
    ) -> bool:
        note = self._run.journal.note
        what = f"there is room for architecture '{architecture.name}'"
        note("decided", f"{what}: it is taken back", placement=where)
        self._try_at, self._try_again = now + _TRY_AGAIN, _TRY_AGAIN
        if start_together(self._run, where):
            self._stays[architecture.name] = (
                now,
                self._stays.get(architecture.name, (now, FIRST / 2))[1],
            )
            return True
        self.note([architecture.name], "it could not be started", now)
        return False

    def _is_due(self, name: str, now: float) -> bool:
        return now >= self._stays.get(name, (now, 0.0))[0]

    def _aside(self) -> list[Architecture]:
        return not_running(self._run.robot, self._task, self._run.placed)

    def _add(self, name: str, why: str) -> None:
        before = self._known.get(name)
        self._known[name] = _Aside(why, before.since if before else time.time())
        if before is None or before.why != why:
            self._run.journal.note("wrong", _sentence(name, why))


def not_running(robot: Robot, task: str, placed: Iterable[str]) -> list[Architecture]:
    """Return what a task needs and does not run, the highest priority first.

    Of alternatives all are listed, the best one first.
    """
    there = set(placed)
    functions = {*robot.functions_of(task)}
    running = {
        a.function
        for a in robot.architectures
        if not there.isdisjoint(c.name for c in a.components)
    }
    return sorted(
        (
            a
            for a in robot.architectures
            if a.function in functions - running and a.layer == "sequencing"
        ),
        key=lambda a: (-a.priority, -a.quality),
    )


def _room_for(facts: Facts, architecture: Architecture) -> Mapping[str, str]:
    """Return where its components fit beside what runs; empty: they do not."""
    allowed = allowed_computers(facts.robot)
    homes: dict[str, tuple[str, ...]] = {
        n: (at,) for n, at in facts.placement.items() if at not in facts.lost
    }
    for component in architecture.components:
        choices = tuple(sorted(allowed[component.name] - facts.lost))
        if not choices:
            return {}
        homes[component.name] = choices
    try:
        result = placed_beside(facts, homes, is_cautious=True)
    except RobotError:
        return {}
    names = {c.name for c in architecture.components}
    return {n: at for n, at in result.placement.items() if n in names}


def _architecture(robot: Robot, name: str) -> Architecture:
    for architecture in robot.architectures:
        if architecture.name == name:
            return architecture
    raise UsageError(f"robot '{robot.name}' has no architecture {quoted(name)}")


def _sentence(name: str, why: str) -> str:
    return f"architecture '{name}' is put aside: {why}"
