"""T-Rot drives through a home: placed by hand and by Poise, and while a part moves.

It imports internal modules: it moves a component amid a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from msgspec import Struct
from rich.console import Console
from rich.markup import escape

from poise.errors import RunError
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.move import move
from poise.model.robot import Robot
from poise.session.callbacks import Check, nothing
from poise.session.placing.placement import Placement, place
from poise.session.profiling.stored_profiles import as_when_profiled
from poise.session.render.run_progress import progress
from poise.session.render.tables import outcome_sentence
from poise.session.robot_file import load
from poise.session.run import Meanwhile, run
from poise.session.run_report import RunReport
from poise.units import format_seconds
from poise.wire.records.status_records import Summary, TimerStatus

NAVIGATOR = "motion_controller"
"""The component whose deadlines tell whether the robot drives well."""
DRIVE = 20.0
CALLS = 2.0
MOVE_AT = 4.0
_MOVED = "localiser"
_MOST_MISSED = 0.01
"""Share of deadlines that Poise may miss."""
_COUNTS_BEFORE_END = 2


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


def drive_once(
    examples: Path, method: str, console: Console, check: Check
) -> RunReport:
    """Drive once; a second time when the host spoilt the first."""
    titles = {
        "static": "placed by hand: on main what can be there",
        "auto": "where Poise puts it",
    }
    console.print(f"\n[bold]T-Rot, {titles[method]}")
    robot = _load(examples / "trot", console)
    for _ in range(2):
        report = _serve(robot, place(robot, "serve", method=method), console, check)
        console.print(_outcome(report))
        if not report.invalid:
            break
    return report


def _load(example: Path, console: Console) -> Robot:
    with console.status("checking the robot file and its code ..."):
        return load(example / "robot.yaml", say=console.print)


def _navigators_cycle(report: RunReport) -> TimerStatus:
    (cycle,) = report.component(NAVIGATOR).timers
    return cycle


def missed_share(report: RunReport) -> float:
    """Return the share of the navigator's 200 ms deadlines that were missed."""
    cycle = _navigators_cycle(report)
    return cycle.missed / cycle.releases if cycle.releases else 1.0


def is_at_goal(report: RunReport) -> bool:
    """Return whether the robot reached its goal."""
    return bool(report.simulation.get("goal_reached"))


def failed_functions(report: RunReport) -> list[str]:
    """Return the functions that did not work, as the world saw it."""
    functions = report.simulation.get("functions", {})
    return [name for name, works in functions.items() if not works]


def _outcome(report: RunReport) -> str:
    if report.invalid:
        return f"[yellow]invalid run:[/] {report.invalid}"
    reached = "reached its goal" if is_at_goal(report) else "did not reach its goal"
    return (
        f"the robot {reached} in {report.seconds:.1f} s; the navigator missed "
        f"{missed_share(report):.1%} of its deadlines"
    )


def move_while_driving(
    examples: Path, console: Console, check: Check = nothing
) -> Scene:
    """Let the robot drive, move its localiser in mid-drive, and tell how it went."""
    console.print("\n[bold]T-Rot's localiser moves while it drives")
    robot = _load(examples / "trot", console)
    placed = place(robot, "serve")
    target = next(c.name for c in robot.computers if c.name != placed[_MOVED])
    mover = _Mover(target)
    scene = mover.scene(_serve(robot, placed, console, check, mover.look))
    console.print(told(scene))
    return scene


class _Mover:
    """Moves the localiser in mid-drive, and counts deadlines around that."""

    def __init__(self, target: str) -> None:
        self._target = target
        self._report: MigrationReport | None = None
        self._ended = 0.0
        self._counts: list[tuple[int, int]] = [(0, 0)]

    def look(self, run: RunningComponents, now: float) -> None:
        """Move when it is time; `now` is since the start of the drive [s]."""
        if self._report is None and now > MOVE_AT:
            self._counts.append(_deadlines(run))
            self._report = move(run, _MOVED, self._target)
            self._ended = now + self._report.prepared + self._report.downtime
        elif len(self._counts) == _COUNTS_BEFORE_END and now > self._ended + 1:
            self._counts.append(_deadlines(run))

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


def _deadlines(run: RunningComponents) -> tuple[int, int]:
    """Return how many deadlines the navigator missed so far, and how many it had."""
    for component in components_of(run.agents.statuses()):
        if component.name == NAVIGATOR:
            (cycle,) = component.timers
            return cycle.missed, cycle.releases
    raise RunError(f"component '{NAVIGATOR}' is gone")


def told(scene: Scene) -> str:
    """Return what happened, for people."""
    report = scene.move
    if not report.committed:
        return f"[yellow]{escape(outcome_sentence(report))}[/]"
    parts = ("before", scene.before), ("during", scene.during), ("after", scene.after)
    missed = ", ".join(f"{name} {m} of {of}" for name, (m, of) in parts)
    return (
        f"{_MOVED} went from {report.before[_MOVED]} to {report.after[_MOVED]}; "
        f"downtime {format_seconds(report.downtime)}; deadlines missed: {missed}; goal "
        f"{'reached' if scene.goal_reached else 'not reached'}"
    )


def _serve(
    robot: Robot,
    placed: Placement,
    console: Console,
    check: Check,
    meanwhile: Meanwhile = lambda *_: None,
) -> RunReport:
    """Run T-Rot's task and show how it goes on."""
    with progress(console, DRIVE, live=True) as show:

        def look(run: RunningComponents, now: float) -> None:
            show(run, now)
            meanwhile(run, now)

        report = run(
            as_when_profiled(robot),
            "serve",
            seconds=DRIVE,
            placement=placed,
            say=console.print,
            meanwhile=look,
            check=check,
        )
    if not report.invalid and "goal_reached" not in report.simulation:
        raise RunError(
            f"the simulator's result lacks 'goal_reached': {report.simulation}"
        )
    return report


def time_calls(examples: Path, console: Console, check: Check) -> dict[str, Summary]:
    """Return how long calls take: ``direct``, and by ``message`` between computers."""
    console.print("\n[bold]How long calls take")
    robot = _load(examples / "calls", console)
    with progress(console, CALLS, live=True) as show:
        report = run(
            robot,
            "call",
            seconds=CALLS,
            say=console.print,
            meanwhile=show,
            check=check,
        )
    measures = report.component("caller").measures
    return {"direct": measures["near"], "message": measures["far"]}


def find_trouble(runs: Sequence[RunReport]) -> str:
    """Return what did not come out as in the paper; empty when all did."""
    static, auto = runs
    for drive in runs:
        if drive.invalid:
            return f"the run with {drive.method} placement is invalid: {drive.invalid}"
    if not failed_functions(static):
        return "all functions worked with static placement; in the paper, one failed"
    if failed := failed_functions(auto):
        return f"with Poise's placement these failed: {', '.join(failed)}"
    if missed_share(auto) >= _MOST_MISSED:
        return "Poise's placement did not meet the navigator's deadlines"
    return ""
