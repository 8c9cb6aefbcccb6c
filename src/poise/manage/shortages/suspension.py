"""Architectures that do not run because not all fits: put aside, and taken back.

What is not running is read from the placement, so that a manager that takes over knows
it, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from msgspec import Struct, structs

from poise.clock import wall_time
from poise.errors import UsageError
from poise.estimate.profile.code_version import version_of
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.migration_report import TransitionStep
from poise.manage.migration.transition_run import transit
from poise.manage.observe.deviations import Deviation
from poise.model.robot import Architecture, Robot, Task

FIRST = 10.0
"""An architecture stays aside for this time at least [s]; twice as long each time."""
LONGEST = 300.0
"""It never has to stay aside for longer [s]."""
FORGET_AFTER = 600.0
"""After so long at work [s] it counts as put aside for the first time again."""
_LOOK_AT_CODE = 2.0
"""Whether the code of what crashed is another is looked at so often [s]."""


class _Aside(Struct):
    """Why an architecture does not run."""

    why: str
    since: float  # [s since 1970]


class PutAside:
    """What a robot's task needs, but does not run. Times are those of one clock [s]."""

    def __init__(
        self, run: RunningComponents, task: Callable[[], Task], why: str = ""
    ) -> None:
        self._run = run
        self._task = task
        self._why = why
        self._known: dict[str, _Aside] = {}
        self._stays: dict[str, tuple[float, float]] = {}
        self._crashed: dict[str, str] = {}
        self._look_at_code = 0.0
        self._has_news = False
        self.held: set[str] = set()
        """The architectures that stopped because their task lacks another function."""

    def put(self, names: Iterable[str], why: str, now: float) -> bool:
        """Stop architectures; return whether that went well.

        Their state is lost.
        """
        run, names = self._run, tuple(names)
        components: dict[str, str] = {}
        for name in names:
            architecture = run.robot.architecture(name)
            if architecture.layer != "sequencing":
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
        committed = self._stop(components)
        if committed:
            self.note(names, why, now)
        return committed

    def note(self, names: Iterable[str], why: str, now: float) -> None:
        """Remember and say that architectures were stopped."""
        for name in names:
            self._stay(name, now, first=FIRST)
            self._add(name, why)

    def hold(
        self,
        architectures: Iterable[Architecture],
        components: Mapping[str, str],
        why: str,
        now: float,
    ) -> None:
        """Stop architectures until what their task lacks is back."""
        if self._stop(components):
            for architecture in architectures:
                self.held.add(architecture.name)
                self._stay(architecture.name, now, first=0.0)
                self._add(architecture.name, why)

    def note_started(self, names: Iterable[str], now: float) -> None:
        """Remember that architectures run again."""
        self.held.difference_update(names)
        for name in names:
            stay = self._stays.get(name, (now, FIRST / 2))[1]
            self._stays[name] = now, stay

    def bar(self, name: str) -> None:
        """Take an architecture that crashes back only with other code, or `forgive`."""
        architecture = self._run.robot.architecture(name)
        self._crashed[name] = self._code_of(architecture)

    def forgive(self) -> None:
        """Take back soon what fits, also what crashed: a person asked for it."""
        for name in self._crashed:
            what = f"architecture '{name}' may start again, though it crashed"
            self._run.journal.note("decided", what)
        self._crashed.clear()
        self._stays.clear()
        self._has_news = True

    def look(self) -> None:
        """Note what does not run, and what runs again."""
        aside = {each.name: each.function for each in self._aside()}
        for name in sorted(self._known.keys() - aside.keys()):
            del self._known[name]
            self._run.journal.note("right", f"architecture '{name}' runs again")
        known = {aside[name] for name in self._known}
        for name, function in aside.items():
            if function not in known:
                known.add(function)
                self._add(name, self._why or "it does not run")

    def functions(self) -> frozenset[str]:
        """Return the functions of what is aside."""
        known = self._known.keys()
        robot = self._run.robot
        return frozenset(a.function for a in robot.architectures if a.name in known)

    def deviations(self) -> tuple[Deviation, ...]:
        """Return what is aside; from any thread."""
        return tuple(
            Deviation(what=_sentence(name, each.why), computer="", since=each.since)
            for name, each in sorted(self._known.copy().items())
        )

    def due(self, now: float) -> list[Architecture]:
        """Return what may be started again, the highest priority first."""
        self._forgive_mended(now)
        return [a for a in self._aside() if self._is_due(a.name, now)]

    def take_news(self) -> bool:
        """Return whether something may start since the last time that could not."""
        has_news, self._has_news = self._has_news, False
        return has_news

    def _stop(self, components: Mapping[str, str]) -> bool:
        steps = tuple(
            TransitionStep(component, computer)
            for component, computer in sorted(components.items())
        )
        return transit(self._run, steps).committed

    def _stay(self, name: str, now: float, *, first: float) -> None:
        """Let one stay aside: `first` [s], and longer when it is so again."""
        until, stay = self._stays.get(name, (float("-inf"), 0.0))
        is_first = now - until >= FORGET_AFTER
        stay = max(first, FIRST / 2) if is_first else min(2 * stay, LONGEST)
        self._stays[name] = now + (first if is_first else stay), stay

    def _is_due(self, name: str, now: float) -> bool:
        is_over = now >= self._stays.get(name, (now, 0.0))[0]
        return is_over and name not in self._crashed

    def _forgive_mended(self, now: float) -> None:
        """Look, now and then, whether the code of what crashed is another."""
        if now < self._look_at_code:
            return
        self._look_at_code = now + _LOOK_AT_CODE
        for name, code in list(self._crashed.items()):
            if self._code_of(self._run.robot.architecture(name)) != code:
                del self._crashed[name]
                self._has_news = True
                what = f"the code of architecture '{name}' has changed"
                self._run.journal.note("seen", what)

    def _code_of(self, architecture: Architecture) -> str:
        robot = self._run.robot
        folders = robot.folder, *robot.repository
        return " ".join(version_of(c, *folders) for c in architecture.components)

    def _aside(self) -> list[Architecture]:
        task = self._task()
        robot = structs.replace(self._run.robot, tasks=(task,))
        return not_running(robot, task.name, self._run.placed)

    def _add(self, name: str, why: str) -> None:
        before = self._known.get(name)
        self._known[name] = _Aside(why, before.since if before else wall_time())
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


def _sentence(name: str, why: str) -> str:
    return f"architecture '{name}' is put aside: {why}"
