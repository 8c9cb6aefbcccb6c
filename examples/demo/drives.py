"""T-Rot drives through a home: placed by hand and by Poise, and while a part moves.

It imports internal modules: it sets how quick the emulated computers are.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace
from rich.console import Console
from rich.markup import escape

from poise import (
    Placement,
    Robot,
    RolledBack,
    RunError,
    Running,
    RunReport,
    load,
    place,
    run,
)
from poise.manage.migration.migration_report import MigrationReport
from poise.session import Check, nothing
from poise.session.profiling.stored_profiles import as_when_profiled
from poise.session.render.run_progress import progress
from poise.session.render.tables import outcome_sentence
from poise.session.run import Meanwhile
from poise.units import counted, format_seconds
from poise.wire.records.status_records import Summary, TimerStatus

NAVIGATOR = "motion_controller"
"""The component whose deadlines tell whether the robot drives well."""
DRIVE = 20.0
CALLS = 2.0
MEASURED = 8.0
"""How long it is measured what the components need [s]."""
FULL = 0.85
"""What the components use of the fullest computer, placed by Poise."""
MOVE_AT = 4.0
_MOVED = "localiser"
_ROOM = 1.4
_MOST_MISSED = 0.05
"""Share of deadlines that Poise may miss."""
_COUNTS_BEFORE_END = 2
_MOST_NAMED = 2


class Scene(Struct, frozen=True, kw_only=True):
    """A component moves while the robot drives.

    Parameters
    ----------
    before, during, after
        Deadlines of the navigator that were missed, and how many there were: until the
        move began, until a second after it ended, and from then on.
    """

    move: MigrationReport
    before: tuple[int, int]
    during: tuple[int, int]
    after: tuple[int, int]
    goal_reached: bool
    invalid: str


class FittedRobot(NamedTuple):
    """A robot as it is `planned`, and `emulated`: as quick as this machine makes it."""

    planned: Robot
    emulated: Robot

    def placed(self, method: str = "auto") -> Placement:
        """Return where its components go."""
        return place(self.planned, "serve", method=method)

    def quicker(self, times: float) -> FittedRobot:
        """Return it with computers that are some times as quick."""
        computers = [replace(c, speed=c.speed * times) for c in self.emulated.computers]
        emulated = replace(self.emulated, computers=tuple(computers))
        return FittedRobot(self.planned, emulated)


def load_trot(examples: Path) -> FittedRobot:
    """Return T-Rot with computers as quick as those that it was profiled on."""
    robot = _without_alternatives(_load(examples / "trot"))
    return FittedRobot(robot, as_when_profiled(robot))


def fill(robot: FittedRobot, console: Console, check: Check) -> FittedRobot:
    """Return the robot with computers that Poise's placement fills to `FULL`.

    How much of them the components need is measured on this machine. So they are as
    full on any machine. The first to emulate them, it says what that goes without.
    """
    placed = robot.placed()
    report = _serve(robot.emulated, placed, console, check, seconds=MEASURED)
    for sentence in report.without:
        console.print(f"  [yellow]without[/] {sentence}")
    return robot.quicker(max(report.cpu_share.values()) / FULL)


def drive_once(
    robot: FittedRobot, method: str, console: Console, check: Check = nothing
) -> RunReport:
    """Drive once, and a second time when the machine was too busy in the first."""
    placed, driven = robot.placed(method), robot.emulated
    if method == "static":
        driven = _without_priorities(driven)
    for is_last in (False, True):
        report = _serve(driven, placed, console, check)
        if not report.invalid or is_last:
            break
        console.print(f"  [yellow]once more:[/] {report.invalid}")
    for line in _outcome(report):
        console.print(f"  {line}")
    return report


def _load(example: Path) -> Robot:
    return load(example / "robot.yaml", say=nothing)


def _without_alternatives(robot: Robot) -> Robot:
    """Return the robot with the best architecture of each function alone.

    So all drives have the same components, whatever was learned from others.
    """
    best = sorted(robot.architectures, key=lambda a: a.quality)
    chosen = tuple({a.function: a for a in best}.values())
    kept = {component.name for a in chosen for component in a.components}
    connectors = (
        each
        for each in robot.connectors
        if kept >= {end.component for end in each.between}
    )
    return replace(robot, architectures=chosen, connectors=tuple(connectors))


def _without_priorities(robot: Robot) -> Robot:
    """Return the robot as the paper had it: all functions are equal."""
    equal = (replace(a, priority=0) for a in robot.architectures)
    return replace(robot, architectures=tuple(equal))


def _navigators_cycle(report: RunReport) -> TimerStatus:
    (cycle,) = report.component(NAVIGATOR).timers
    return cycle


def missed_share(report: RunReport) -> float:
    """Return the share of the navigator's 200 ms deadlines that were missed."""
    cycle = _navigators_cycle(report)
    return cycle.missed / cycle.releases if cycle.releases else 1.0


def late_share(report: RunReport, chain: str) -> float:
    """Return the share of the uses of a chain's data that came after its deadline."""
    (found,) = (each for each in report.chains if each.name == chain)
    return found.missed / found.age.count if found.age.count else 1.0


def is_at_goal(report: RunReport) -> bool:
    """Return whether the robot reached its goal."""
    return bool(report.simulation.get("goal_reached"))


def failed_functions(report: RunReport) -> list[str]:
    """Return the functions that did not work, as the world saw it."""
    functions = report.simulation.get("functions", {})
    return [name for name, works in functions.items() if not works]


def goal_sentence(report: RunReport) -> str:
    """Return whether the robot reached its goal, and when or how far from it it is."""
    if is_at_goal(report):
        return f"reached in {report.seconds:.0f} s"
    left = report.simulation.get("distance_to_goal")
    return "not reached" if left is None else f"missed by {left:.1f} m"


def _outcome(report: RunReport) -> Iterator[str]:
    """Yield what came of a drive, and what was late in it."""
    if report.invalid:
        yield f"[yellow]invalid run:[/] {report.invalid}"
    yield (
        f"goal {goal_sentence(report)}; the pose was older than 200 ms at "
        f"{late_share(report, 'pose'):.0%} of the checks"
    )
    misses = {
        component.name: sum(timer.missed for timer in component.timers)
        for component in report.components
    }
    worst = sorted(filter(misses.get, misses), key=lambda name: -misses[name])
    said = [f"{name} {misses[name]}" for name in worst[:_MOST_NAMED]]
    if others := worst[_MOST_NAMED:]:
        number = sum(misses[name] for name in others)
        said.append(f"{counted(len(others), 'other')} {number}")
    yield f"deadlines missed: {', '.join(said) or 'none'}"


def move_while_driving(
    robot: FittedRobot, console: Console, check: Check = nothing
) -> Scene:
    """Let the robot drive, move its localiser in mid-drive, and tell how it went.

    Its computers are made quicker, so that both have room for the localiser.
    """
    placed, driven = robot.placed(), robot.quicker(_ROOM).emulated
    target = next(c.name for c in robot.planned.computers if c.name != placed[_MOVED])
    mover = _Mover(target)
    scene = mover.scene(_serve(driven, placed, console, check, mover.look))
    console.print(f"  {told(scene)}")
    return scene


class _Mover:
    """Moves the localiser in mid-drive, and counts deadlines around that."""

    def __init__(self, target: str) -> None:
        self._target = target
        self._report: MigrationReport | None = None
        self._ended = 0.0
        self._counts: list[tuple[int, int]] = [(0, 0)]

    def look(self, running: Running, now: float) -> None:
        """Move when it is time; `now` is since the start of the drive [s]."""
        if self._report is None and now > MOVE_AT:
            self._counts.append(_deadlines(running))
            self._report = _moved(running, self._target)
            self._ended = now + self._report.prepared + self._report.downtime
        elif len(self._counts) == _COUNTS_BEFORE_END and now > self._ended + 1:
            self._counts.append(_deadlines(running))

    def scene(self, report: RunReport) -> Scene:
        """Return what came of it."""
        if self._report is None:
            raise RunError(f"the drive ended before {MOVE_AT:g} s: {report.simulation}")
        cycle = _navigators_cycle(report)
        counts = [*self._counts, (cycle.missed, cycle.releases)]
        parts = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(counts)]
        before, during, after = (*parts, (0, 0))[:3]
        return Scene(
            move=self._report,
            before=before,
            during=during,
            after=after,
            goal_reached=is_at_goal(report),
            invalid=report.invalid,
        )


def _moved(running: Running, target: str) -> MigrationReport:
    """Move the localiser, and return how it went."""
    try:
        return running.move(_MOVED, target, force=True)
    except RolledBack as error:
        if not isinstance(error.outcome, MigrationReport):
            raise
        return error.outcome


def _deadlines(running: Running) -> tuple[int, int]:
    """Return how many deadlines the navigator missed so far, and how many it had."""
    for _, component in running.status().located():
        if component.name == NAVIGATOR:
            (cycle,) = component.timers
            return cycle.missed, cycle.releases
    raise RunError(f"component '{NAVIGATOR}' is gone")


def told(scene: Scene) -> str:
    """Return what happened, for people."""
    report = scene.move
    if not report.committed:
        return f"[yellow]{escape(outcome_sentence(report))}[/]"
    times = ("before", scene.before), ("during", scene.during), ("after", scene.after)
    missed = ", ".join(f"{m} of {of} {time}" for time, (m, of) in times)
    return (
        f"{_MOVED}: {report.before[_MOVED]} -> {report.after[_MOVED]}, downtime "
        f"{format_seconds(report.downtime)}; goal "
        f"{'reached' if scene.goal_reached else 'not reached'}\n"
        f"  deadlines missed: {missed}"
    )


@contextlib.contextmanager
def _shown(console: Console, seconds: float) -> Iterator[Meanwhile]:
    """Show how a run goes on, in a terminal; elsewhere each would be a line more."""
    if not console.is_terminal:
        yield nothing
        return
    with progress(console, seconds, live=True) as show:
        yield show


def _serve(
    robot: Robot,
    placed: Placement,
    console: Console,
    check: Check,
    meanwhile: Meanwhile = nothing,
    *,
    seconds: float = 0.0,
) -> RunReport:
    """Run T-Rot's task for some time [s], and show how it goes on."""
    lasts = seconds or DRIVE
    with _shown(console, lasts) as show:

        def look(running: Running, now: float) -> None:
            show(running, now)
            meanwhile(running, now)

        report = run(
            robot,
            "serve",
            seconds=lasts,
            placement=placed,
            say=nothing,
            meanwhile=look,
            check=check,
        )
    if report.interrupted:
        raise RunError(f"a drive was ended early: {report.invalid or 'by a signal'}")
    if not report.invalid and "goal_reached" not in report.simulation:
        raise RunError(
            f"the simulator's result lacks 'goal_reached': {report.simulation}"
        )
    return report


def time_calls(examples: Path, console: Console, check: Check) -> dict[str, Summary]:
    """Return how long calls take: ``direct``, and by ``message`` between computers."""
    robot = _load(examples / "calls")
    with _shown(console, CALLS) as show:
        report = run(
            robot, "call", seconds=CALLS, say=nothing, meanwhile=show, check=check
        )
    measures = report.component("caller").measures
    return {"direct": measures["near"], "message": measures["far"]}


def find_trouble(runs: Sequence[RunReport]) -> str:
    """Return what did not come out as in the paper; empty when all did."""
    static, auto = runs
    if "navigation" not in failed_functions(static):
        return "the navigator worked with static placement; in the paper, it failed"
    if "navigation" in failed_functions(auto):
        return "the navigator failed with Poise's placement, too"
    if missed_share(auto) >= _MOST_MISSED:
        return "Poise's placement did not meet the navigator's deadlines"
    return ""


def too_busy(runs: Sequence[RunReport]) -> str:
    """Return why this machine was too busy for the drives; empty: it was not."""
    return next((drive.invalid for drive in runs if drive.invalid), "")
