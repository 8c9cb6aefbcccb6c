"""Load shedding: suspends architectures for lack of room, and resumes them.

Which architectures do not run is read from the placement, so that a manager that takes
over knows it, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import partial
from itertools import groupby, islice, product
from math import inf
from operator import attrgetter

from msgspec import structs

from poise.clock import wall_time
from poise.errors import UsageError
from poise.estimate.code_version import version_of
from poise.manage.adaptation.situation import Change, Situation
from poise.manage.adaptation.when_to_act import Backoff
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration.migration_report import TransitionStep
from poise.manage.migration.transition_run import start_together, transit
from poise.manage.observe.deviations import Deviation
from poise.manage.shortages.free_room import room_for_components
from poise.model.policy import LASTS
from poise.model.robot import Architecture, Robot, Task
from poise.units import named

FIRST = 10.0
"""An architecture is suspended for this time at least [s]; twice as long each time."""
LONGEST = 300.0
"""It never has to stay suspended for longer [s]."""
FORGET_AFTER = 600.0
"""After so long at work [s] it counts as suspended for the first time again."""
DOUBT_AFTER = 60.0
"""For this time [s] after it may start again, what it needed last counts; then it is
tried with what it needs by the robot file, for what it needed may have passed."""
_CRASHED = (
    "it crashed again and again wherever it may run; it is resumed when its code "
    "changes, or by `poise balance`"
)
_LOOK_AT_CODE = 2.0
"""Whether the code of what crashed is another is looked at so often [s]."""


class Suspensions:
    """What a robot's task needs, but does not run. Times are those of one clock [s]."""

    def __init__(
        self, live: LiveRobot, tasks: Callable[[], tuple[Task, ...]], why: str = ""
    ) -> None:
        self._live = live
        self._tasks = tasks
        self._why = why
        self._known: dict[str, Deviation] = {}
        self._inputs: tuple[Robot, AbstractSet[str], tuple[Task, ...]] | None = None
        self._not_running: list[Architecture] = []
        self._stays: dict[str, Backoff] = {}
        self._look_at_code = 0.0
        self._has_news = False
        self.suspended_with_task: set[str] = set()
        """The architectures that stopped because their task lacks another function."""

    def suspend(
        self, names: Iterable[str], why: str, now: float, *, with_task: bool = False
    ) -> bool:
        """Stop architectures, whose state is lost; return whether that went well."""
        live, names, stopping = self._live, tuple(names), list[str]()
        for name in names:
            architecture = live.robot.architecture(name)
            if architecture.layer != "sequencing":
                raise UsageError(
                    f"architecture '{name}' is in the {architecture.layer} layer, "
                    "which Poise never suspends"
                )
            here = [c.name for c in architecture.components if c.name in live.placed]
            if not here:
                raise UsageError(f"architecture '{name}' does not run")
            stopping += here
        away = live.agents.out_of_reach()
        steps = tuple(
            TransitionStep(name, computer)
            for name in sorted(stopping)
            if (computer := live.placed[name].computer) not in away
        )
        if steps and not transit(live, steps).committed:
            return False
        if gone := {*stopping} - {step.component for step in steps}:
            why_gone = "what is out of reach is not to go on there"
            live.commit(live.desired.without(gone), why_gone)
        self.note_suspended(names, why, now, with_task=with_task)
        return True

    def note_suspended(
        self, names: Iterable[str], why: str, now: float, *, with_task: bool = False
    ) -> None:
        """Remember and say that architectures were stopped."""
        for name in names:
            self._stay(name, now, may_be_short=with_task)
            self._add(name, why)
            if with_task:
                self.suspended_with_task.add(name)

    def note_resumed(self, names: Iterable[str], now: float) -> None:
        """Remember that architectures run again."""
        self.suspended_with_task.difference_update(names)
        for name in names:
            self._stays.setdefault(name, Backoff(FIRST, LONGEST)).again_at = now

    def quarantine(self, name: str) -> None:
        """Take an architecture that crashes back only with other code, or `release`."""
        code, crashed = self._code_of(name), self._live.desired.crashed
        self._note_crashed({**crashed, name: code}, f"'{name}' crashes again and again")

    def release(self) -> None:
        """Take back soon what fits, also what crashed: a person asked for it."""
        for name in self._live.desired.crashed:
            what = f"architecture '{name}' may start again, though it crashed"
            self._live.journal.note("decided", what)
        self._note_crashed({}, "a person asked for it")
        for stay in self._stays.values():
            stay.reset()
        self._has_news = True

    def record(self) -> None:
        """Note what does not run, and what runs again or is not needed any more."""
        live = self._live
        suspended = {each.name: each.function for each in self._suspended()}
        for name in sorted(self._known.keys() - suspended.keys()):
            del self._known[name]
            components = live.robot.architecture(name).components
            runs = any(component.name in live.placed for component in components)
            how = "runs again" if runs else "is not needed any more"
            live.journal.note("right", f"architecture '{name}' {how}")
        known = {suspended[name] for name in self._known}
        for name, function in suspended.items():
            if function not in known:
                known.add(function)
                why = _CRASHED if name in live.desired.crashed else self._why
                self._add(name, why or "it does not run")

    def functions(self) -> frozenset[str]:
        """Return the functions of what is suspended."""
        known = self._known.keys()
        robot = self._live.robot
        return frozenset(a.function for a in robot.architectures if a.name in known)

    def deviations(self) -> tuple[Deviation, ...]:
        """Return what is suspended; from any thread."""
        return tuple(known for _, known in sorted(self._known.copy().items()))

    def due(self, now: float) -> list[Architecture]:
        """Return what may be started again, the highest priority first."""
        self._release_mended(now)
        stay = {name for name, each in self._stays.items() if now < each.again_at}
        stay |= self._live.desired.crashed.keys()
        return [a for a in self._suspended() if a.name not in stay]

    def doubtful(self, now: float) -> frozenset[str]:
        """Return the suspended components whose last demand is believed no more."""
        stays = self._stays.items()
        names = (n for n, stay in stays if now - stay.again_at >= DOUBT_AFTER)
        suspended = {each.name: each.components for each in self._suspended()}
        return frozenset(c.name for n in names for c in suspended.get(n, ()))

    def pop_news(self) -> bool:
        """Return whether something may start since the last time that could not."""
        has_news, self._has_news = self._has_news, False
        return has_news

    def _stay(self, name: str, now: float, *, may_be_short: bool) -> None:
        """Let one stay suspended, and longer when it is so again."""
        stay = self._stays.setdefault(name, Backoff(FIRST, LONGEST))
        is_first = now - stay.again_at >= FORGET_AFTER
        if is_first:
            stay.reset(now)
        if not is_first or not may_be_short:
            stay.start(now)

    def _release_mended(self, now: float) -> None:
        """Look, now and then, whether the code of what crashed is another."""
        if now < self._look_at_code:
            return
        self._look_at_code = now + _LOOK_AT_CODE
        for name, code in self._live.desired.crashed.items():
            if self._code_of(name) != code:
                left = {
                    n: c for n, c in self._live.desired.crashed.items() if n != name
                }
                what = f"the code of architecture '{name}' has changed"
                self._live.journal.note("seen", what)
                self._note_crashed(left, what)
                self._has_news = True

    def _note_crashed(self, crashed: Mapping[str, str], why: str) -> None:
        """Let this manager and the next one know what crashed wherever it may run."""
        self._live.commit(structs.replace(self._live.desired, crashed=crashed), why)

    def _code_of(self, name: str) -> str:
        """Return the code of an architecture that the robot file may have no more."""
        robot = self._live.robot
        # what is deployed is the same for a manager on another computer
        folders = () if robot.deployed else robot.folders
        found = (a.components for a in robot.architectures if a.name == name)
        versions = (version_of(c, *folders) for c in next(found, ()))
        return " ".join([robot.deployed, *versions])

    def _suspended(self) -> list[Architecture]:
        """Return what does not run; worked out when what that depends on changes."""
        inputs = self._live.robot, self._live.placed.keys(), self._tasks()
        if inputs != self._inputs:
            robot, placed, tasks = inputs
            self._inputs = robot, frozenset(placed), tasks
            self._not_running = not_running(structs.replace(robot, tasks=tasks), placed)
        return self._not_running

    def _add(self, name: str, why: str) -> None:
        before = self._known.get(name)
        what = f"architecture '{name}' is suspended: {why}"
        since = before.since if before else wall_time()
        self._known[name] = Deviation(what=what, computer="", since=since)
        if before is None or before.what != what:
            self._live.journal.note("wrong", what)


def not_running(robot: Robot, placed: Iterable[str]) -> list[Architecture]:
    """Return what tasks need and does not run, by priority, then by quality."""
    there = set(placed)
    functions = {*robot.functions_of()}
    running = {
        a.function
        for a in robot.architectures
        if not there.isdisjoint(c.name for c in a.components)
    }
    return [
        a
        for a in sorted(robot.architectures, key=lambda a: (-a.priority, -a.quality))
        if a.function in functions - running and a.layer == "sequencing"
    ]


class NeededFunctions:
    """The functions that a task needs or uses, and since when some are missing [s]."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._since: dict[str, float] = {}
        self._said: dict[str, Deviation] = {}

    def evaluate(self, situation: Situation, now: float) -> AbstractSet[str]:
        """Say what has been missing or is back; return what is needed and missing."""
        missing, tasks = missing_functions(situation), situation.robot.tasks
        needed = {name for task in tasks for name in task.needs}
        _, stopped = situation.stopped(self._said.keys() & missing)
        missing -= stopped - needed - self._said.keys()
        self._since = {name: self._since.get(name, now) for name in missing}
        for name in sorted(self._said.keys() - missing):
            del self._said[name]
            is_used = name in situation.robot.functions_of()
            how = "is back" if is_used else "is not used any more"
            self._journal.note("right", f"function '{name}' {how}")
        lasting = {n for n, since in self._since.items() if now - since >= LASTS}
        for name in sorted(lasting - self._said.keys()):
            what = _missing(situation.robot, name)
            self._said[name] = Deviation(what=what, computer="", since=wall_time())
            self._journal.note("wrong", what)
        return lasting & needed

    def deviations(self) -> tuple[Deviation, ...]:
        """Return what is missing; from any thread."""
        return tuple(self._said.copy().values())


def _missing(robot: Robot, function: str) -> str:
    """Return which tasks stop without a function or, if none does, which go on."""
    if any(function in task.needs for task in robot.tasks):
        return lacking(robot.tasks, {function})
    tasks = [t.name for t in robot.tasks if function in robot.functions_of(t.name)]
    names = [*filter(None, tasks)]
    if not names:
        return f"function '{function}' is missing"
    go = "goes" if len(names) == 1 else "go"
    return f"{named('task', names)} {go} on without function '{function}'"


def lacking(tasks: Iterable[Task], functions: AbstractSet[str]) -> str:
    """Return which tasks stop as they lack functions that they need, for people."""
    stop = [task.name for task in tasks if not functions.isdisjoint(task.needs)]
    need = "needs" if len(stop) == 1 else "need"
    are = "is" if len(functions) == 1 else "are"
    lacked = named("function", sorted(functions))
    return f"{named('task', stop)} {need} {lacked}, which {are} missing"


def missing_functions(situation: Situation) -> AbstractSet[str]:
    """Return the functions of the task that nothing provides now."""
    there = situation.within_reach().placement
    provided = {a.function for a in situation.robot.whole(there)}
    return {*situation.robot.functions_of()} - provided


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

    purpose = "stop a task that lacks a needed function"

    def __init__(self, suspensions: Suspensions) -> None:
        self._suspensions = suspensions
        self._again_at = 0.0

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return what is stopped, if a needed function is missing."""
        now, robot = situation.now, situation.robot
        if not situation.missing or now < self._again_at:
            return None
        there = situation.within_reach().placement
        tasks, functions = situation.stopped(situation.missing)
        stops = [
            a.name
            for a in robot.whole(there)
            if a.components and a.layer == "sequencing" and a.function in functions
        ]
        if not stops:
            return None
        self._again_at = now + _TRY_AGAIN
        why = lacking(tasks, situation.missing)
        stop = self._suspensions.suspend
        return Change(carry_out=partial(stop, stops, why, now, with_task=True))


class ResumeSuspended:
    """Starts what fits again beside the running components, by priority."""

    purpose = "start suspended architectures again"

    def __init__(self, live: LiveRobot, suspensions: Suspensions) -> None:
        self._live = live
        self._suspensions = suspensions
        self._backoff = Backoff(_TRY_AGAIN, LONGEST)
        self._lost: frozenset[str] = frozenset()
        self._doubtful: frozenset[str] = frozenset()
        self._calm_since = inf

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return what starts, when nothing has been wrong for a while."""
        now = situation.now
        if situation.lost != self._lost:
            self._lost = situation.lost
            self._backoff.reset()
        is_wrong = bool(situation.about("replan"))
        self._calm_since = inf if is_wrong else min(self._calm_since, now)
        if now - self._calm_since < CALM:
            return None
        due = [
            a
            for a in self._suspensions.due(now)
            if situation.suspends.isdisjoint((a.name, *(c.name for c in a.components)))
        ]
        if not due:
            return None
        doubtful = self._suspensions.doubtful(now)
        if self._suspensions.pop_news() or doubtful - self._doubtful:
            self._backoff.again_at = now
        self._doubtful = doubtful
        if now < self._backoff.again_at:
            return None
        choices = self._choices(due, situation)
        if not choices:
            return None
        situation = situation.without_estimates(doubtful)
        for architectures in choices:
            names = {c.name for a in architectures for c in a.components}
            if where := room_for_components(situation, names):
                self._backoff.reset(now + _TRY_AGAIN)
                started = [architecture.name for architecture in architectures]
                what = " and ".join(f"architecture '{name}'" for name in started)
                return Change(
                    why=f"there is room: resuming {what}",
                    facts={"placement": where},
                    carry_out=partial(self._start, started, where, now),
                )
        self._backoff.start(now)
        return None

    def _choices(
        self, due: list[Architecture], situation: Situation
    ) -> list[Sequence[Architecture]]:
        """Return what may be taken back together: all that a task needs, or one."""
        choices: list[Sequence[Architecture]] = []
        missing, function = situation.missing, attrgetter("function")
        tasks, stopped = situation.stopped(missing)
        for lacked in (missing.intersection(task.needs) for task in tasks):
            needed = sorted((a for a in due if a.function in lacked), key=function)
            of_each = [list(group) for _, group in groupby(needed, function)]
            if len(of_each) == len(lacked):
                choices += islice(product(*of_each), _MOST_CHOICES)
        free = [a for a in due if a.function not in stopped]
        held = [a for a in free if a.name in self._suspensions.suspended_with_task]
        return [*choices, *([held] if held else []), *([each] for each in free)]

    def _start(self, names: list[str], where: Mapping[str, str], now: float) -> None:
        if start_together(self._live, where):
            self._suspensions.note_resumed(names, now)
        else:
            self._suspensions.note_suspended(names, "it could not be started", now)
