"""Architectures that do not run because not all fits: put aside, and taken back.

What is not running is read from the placement, so that a manager that takes over knows
it, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from itertools import groupby, islice, product

from msgspec import Struct, structs

from poise.clock import wall_time
from poise.errors import UsageError
from poise.estimate.profile.code_version import version_of
from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.shortages.free_room import room_for_components
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.report import TransitionStep
from poise.manage.migration.transition_run import start_together, transit
from poise.manage.observe.deviations import Deviation
from poise.model.robot import Architecture, Robot, Task

FIRST = 10.0
"""An architecture stays aside for this time at least [s]; twice as long each time."""
LONGEST = 300.0
"""It never has to stay aside for longer [s]."""
FORGET_AFTER = 600.0
"""After so long at work [s] it counts as put aside for the first time again."""
CALM = 5.0
"""Nothing must have been wrong for this time before one is taken back [s]."""
_MOST_CHOICES = 8
"""The most combinations of alternatives of needed functions that are tried."""
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
    task
        Returns what should run now, as a task.
    why
        Why architectures do not run from the start on.
    """

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
        self._try_at = 0.0
        self._try_again = _TRY_AGAIN
        self._lost: frozenset[str] = frozenset()
        self._calm_since: float | None = None
        self._held: set[str] = set()
        self._hold_at = 0.0

    def put(self, names: Iterable[str], why: str, now: float) -> bool:
        """Stop architectures; return whether that went well.

        Their state is lost.

        Parameters
        ----------
        why
            A clause for people: "container 'camera' crashes again and again".

        Raises
        ------
        UsageError
            One does not run, or its layer stays as it is.
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

    def hold(self, facts: Facts, why: str, now: float) -> bool:
        """Stop what else a task runs that lacks a needed function.

        What is back within moments goes on: architectures with a component on a lost
        computer stay as they are. Returns whether something was stopped.
        """
        there = {n: at for n, at in facts.placement.items() if at not in facts.lost}
        functions = facts.robot.functions_of(facts.task)
        held = [
            a
            for a in facts.robot.whole(there)
            if a.layer == "sequencing" and a.function in functions
        ]
        if not held or now < self._hold_at:
            return False
        self._hold_at = now + _TRY_AGAIN
        names = {c.name for a in held for c in a.components}
        if not self._stop({name: there[name] for name in names}):
            return False
        for architecture in held:
            self._held.add(architecture.name)
            self._stay(architecture.name, now, first=0.0)
            self._add(architecture.name, why)
        return True

    def note(self, names: Iterable[str], why: str, now: float) -> None:
        """Remember and say that architectures were stopped."""
        for name in names:
            self._stay(name, now, first=FIRST)
            self._add(name, why)

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
        self._try_at = 0.0

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

    def take_back(
        self,
        facts: Facts,
        now: float,
        *,
        is_calm: bool,
        missing: AbstractSet[str] = frozenset(),
    ) -> bool:
        """Start what fits again beside what runs, the highest priority first.

        What runs stays where it is. Returns whether something was started.

        Parameters
        ----------
        missing
            Needed functions that are missing: nothing is taken back but all of them.
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
        self._forgive_mended(now)
        due = [a for a in self._aside() if self._is_due(a.name, now)]
        if not due or now < self._try_at:
            return False
        choices = self._choices(due, missing)
        if not choices:
            return False
        for architectures in choices:
            names = {c.name for a in architectures for c in a.components}
            if where := room_for_components(facts, names):
                return self._start(architectures, where, now)
        self._try_at = now + self._try_again
        self._try_again = min(2 * self._try_again, LONGEST)
        return False

    def _choices(
        self, due: list[Architecture], missing: AbstractSet[str]
    ) -> list[Sequence[Architecture]]:
        """Return what may be taken back together, the best first."""
        if not missing:
            held = [a for a in due if a.name in self._held]
            return [*([held] if held else []), *([each] for each in due)]
        needed = sorted((a for a in due if a.function in missing), key=_function)
        of_each = [list(group) for _, group in groupby(needed, _function)]
        if len(of_each) < len(missing):
            return []
        return [*islice(product(*of_each), _MOST_CHOICES)]

    def _start(
        self,
        architectures: Sequence[Architecture],
        where: Mapping[str, str],
        now: float,
    ) -> bool:
        names = [architecture.name for architecture in architectures]
        what = " and ".join(f"architecture '{name}'" for name in names)
        text = f"there is room: {what} taken back"
        self._run.journal.note("decided", text, placement=where)
        self._try_at, self._try_again = now + _TRY_AGAIN, _TRY_AGAIN
        if not start_together(self._run, where):
            self.note(names, "it could not be started", now)
            return False
        self._held.difference_update(names)
        for name in names:
            stay = self._stays.get(name, (now, FIRST / 2))[1]
            self._stays[name] = now, stay
        return True

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
        self._look_at_code = now + _TRY_AGAIN
        for name, code in list(self._crashed.items()):
            if self._code_of(self._run.robot.architecture(name)) != code:
                del self._crashed[name]
                self._try_at = 0.0
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


def _function(architecture: Architecture) -> str:
    return architecture.function


def _sentence(name: str, why: str) -> str:
    return f"architecture '{name}' is put aside: {why}"
