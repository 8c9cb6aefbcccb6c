"""A scene of `poise demo`: the robot's localiser moves while it drives."""

from __future__ import annotations

import itertools
from pathlib import Path

from msgspec import Struct
from rich.console import Console
from rich.markup import escape

from poise.cli.interrupts import interrupts
from poise.cli.render.progress import progress
from poise.errors import RunError
from poise.manage.migration.move import MoveReport, move
from poise.manage.run import Run
from poise.manage.statuses import components_of
from poise.model.robot import Robot
from poise.session.placement import Placement, place
from poise.session.report import RunReport
from poise.session.robot_file import load
from poise.session.run import Meanwhile
from poise.session.run import run as run_task
from poise.units import format_seconds

NAVIGATOR = "motion_controller"
"""The component whose deadlines tell whether the robot drives well."""
_DRIVE = 20.0
_MOVED = "localiser"
_MOVE_AT = 4.0


class Scene(Struct, frozen=True, kw_only=True):
    """A component moves while the robot drives.

    Parameters
    ----------
    before, during, after
        Deadlines of the navigator that were missed, and how many there were: until the
        move began, until a second after it ended, and from then on.
    """

    move: MoveReport
    before: tuple[int, int]
    during: tuple[int, int]
    after: tuple[int, int]
    goal_reached: bool
    invalid: str


def move_while_driving(examples: Path, console: Console) -> Scene:
    """Let the robot drive, move its localiser in mid-drive, and tell how it went."""
    console.print("\n[bold]T-Rot's localiser moves while it drives")
    robot = load(examples / "trot" / "robot.yaml", say=console.print)
    placed = place(robot, "serve")
    there = placed[_MOVED]
    target = next(c.name for c in robot.computers if c.name != there)
    mover = _Mover(target)
    report = serve(robot, placed, console, mover.look)
    scene = mover.scene(report)
    console.print(told(scene))
    return scene


class _Mover:
    """Moves the localiser in mid-drive, and counts deadlines around that."""

    def __init__(self, target: str) -> None:
        self._target = target
        self._report: MoveReport | None = None
        self._ended = 0.0
        self._counts: list[tuple[int, int]] = []

    def look(self, run: Run, now: float) -> None:
        """Move when it is time; `now` is since the start of the drive [s]."""
        if self._report is None and now > _MOVE_AT:
            self._counts.append(_deadlines(run))
            self._report = move(run, _MOVED, self._target)
            self._ended = now + self._report.prepared + self._report.downtime
        elif len(self._counts) == 1 and now > self._ended + 1:
            self._counts.append(_deadlines(run))

    def scene(self, report: RunReport) -> Scene:
        """Return what came of it."""
        if self._report is None:
            raise RunError(
                f"the drive ended before {_MOVE_AT:g} s: {report.simulation}"
            )
        (cycle,) = report.component(NAVIGATOR).timers
        counts = [(0, 0), *self._counts, (cycle.missed, cycle.releases)]
        parts = [(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(counts)]
        before, during, after = (*parts, (0, 0))[:3]
        return Scene(
            move=self._report,
            before=before,
            during=during,
            after=after,
            goal_reached=bool(report.simulation.get("goal_reached")),
            invalid=report.invalid,
        )


def _deadlines(run: Run) -> tuple[int, int]:
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
        why = escape(report.reason)
        return f"[yellow]{_MOVED} stayed on {report.source}:[/] {why}"
    parts = ("before", scene.before), ("during", scene.during), ("after", scene.after)
    missed = ", ".join(f"{name} {m} of {of}" for name, (m, of) in parts)
    return (
        f"{_MOVED} went from {report.source} to {report.target}; downtime "
        f"{format_seconds(report.downtime)}; deadlines missed: {missed}; goal "
        f"{'reached' if scene.goal_reached else 'not reached'}"
    )


def serve(
    robot: Robot,
    placed: Placement,
    console: Console,
    meanwhile: Meanwhile | None = None,
) -> RunReport:
    """Run T-Rot's task and show how it goes on."""
    with progress(console, _DRIVE, live=True) as show:

        def look(run: Run, now: float) -> None:
            show(run, now)
            if meanwhile is not None:
                meanwhile(run, now)

        return run_task(
            robot,
            "serve",
            seconds=_DRIVE,
            placement=placed,
            say=console.print,
            meanwhile=look,
            check=interrupts.check,
        )
