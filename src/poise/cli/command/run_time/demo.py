"""`poise demo`: the paper's case study, with static placement and with Poise's."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import typer
from msgspec import Struct
from rich.console import Console
from rich.markup import escape

from poise.cli.interrupts import Interrupts
from poise.cli.options import AsJson, print_json
from poise.errors import RobotError, RunError
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.running_components import Run
from poise.manage.migration.move import MoveReport, move
from poise.model.robot import Robot
from poise.session.callbacks import Check, nothing
from poise.session.launch.printer import STDERR, Printer
from poise.session.launch.temporary_folders import scratch_folder
from poise.session.placing.placement import Placement, place
from poise.session.render.moves import outcome_sentence
from poise.session.render.progress import progress
from poise.session.render.shared_tables.columns import table
from poise.session.reports.run_report import RunReport
from poise.session.robot_file import load
from poise.session.run import Meanwhile, run
from poise.session.scenes import SCENES
from poise.units import format_seconds
from poise.view.drives_picture import DrivePicture, drives_picture
from poise.wire.records.status import Summary, TimerStatus

EXAMPLES = Path(__file__).parents[5] / "examples"
_NAVIGATOR = "motion_controller"
"""The component whose deadlines tell whether the robot drives well."""
_DRIVE = 20.0
_CALLS = 2.0
_MOVED = "localiser"
_MOVE_AT = 4.0
_MOST_MISSED = 0.01
"""Share of deadlines that Poise may miss."""
_COUNTS_BEFORE_END = 2
_TITLES = {"static": "static (what can, on Main)", "auto": "Poise"}
_PICTURE = Path("poise-demo.svg")


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


class DemoReport(Struct, frozen=True, kw_only=True):
    """All that the demo measured.

    Parameters
    ----------
    runs
        Two drives: placed by hand, and by Poise.
    calls
        How long calls take: in one container, and between two computers [s].
    """

    runs: tuple[RunReport, ...]
    scene: Scene
    calls: Mapping[str, Summary]


def demo_command(
    as_json: AsJson = False,
    scene: Annotated[
        Literal["overload", "lost-computer", "cut-link", "manager-killed", "tasks"]
        | None,
        typer.Option(help="Show instead how a running robot adapts, or runs tasks."),
    ] = None,
    examples: Annotated[
        Path, typer.Option(help="The folder with the examples trot and calls.")
    ] = EXAMPLES,
) -> None:
    """Drive a home service robot through a home, placed by hand and by Poise.

    25 components on two emulated computers, as in the paper's case study: first all on
    the main computer that can run there, then where Poise puts them. Takes about a
    minute, and draws both drives in poise-demo.svg.

    With --scene, a small robot adapts by itself: another program overloads one of its
    computers, a computer loses power, or the manager is killed amid a move; or three
    tasks share functions, and one pauses another.

    Examples
    --------
    poise demo

    poise demo --scene overload
    """
    if scene is not None:
        _play(scene, examples, as_json=as_json)
        return
    if not (examples / "trot" / "robot.yaml").is_file():
        raise RobotError(
            f"the demo's robot is not at {examples}: run it in a clone of Poise, or "
            "give its examples folder with --examples"
        )
    console = Console(stderr=as_json, highlight=False)
    with Interrupts() as interrupts:
        check = interrupts.check
        report = DemoReport(
            runs=tuple(_drive(examples, each, console, check) for each in _TITLES),
            scene=move_while_driving(examples, console, check),
            calls=_calls(examples, console, check),
        )
    print_json(report) if as_json else _show(report, console)
    _draw(report.runs, console)
    trouble = find_trouble(report.runs)
    if trouble:
        Console(stderr=True).print(trouble)
        raise typer.Exit(1)


def _play(scene: str, examples: Path, *, as_json: bool) -> None:
    with Printer(STDERR) as printer, Interrupts() as interrupts:
        example, play = SCENES[scene]
        with scratch_folder("poise-demo-") as folder:
            file = _renamed(examples / example, folder / example)
            robot = load(file, say=printer.print)
            report = play(robot, printer.print, interrupts.check)
    if as_json:
        print_json(report)
    else:
        for key, value in msgspec.structs.asdict(report).items():
            Console(highlight=False).print(f"{key:16}{value}")
    if not report.ok:
        raise typer.Exit(1)


def _renamed(example: Path, folder: Path) -> Path:
    """Return the robot file in a copy of an example, with a name of its own.

    Emulated computers and managers are found by it, and another may be up.
    """
    file = shutil.copytree(example, folder) / "robot.yaml"
    old, new = f"robot: {example.name}\n", f"robot: {example.name}-{os.getpid()}\n"
    file.write_text(file.read_text(encoding="utf-8").replace(old, new, 1))
    return file


def _drive(examples: Path, method: str, console: Console, check: Check) -> RunReport:
    """Drive once; a second time when the host spoilt the first."""
    titles = {"static": "on Main what can be there", "auto": "where Poise puts it"}
    console.print(f"\n[bold]T-Rot, {titles[method]}")
    robot = load(examples / "trot" / "robot.yaml", say=console.print)
    for _ in range(2):
        report = _serve(robot, place(robot, "serve", method=method), console, check)
        console.print(_outcome(report))
        if not report.invalid:
            break
    return report


def _navigators_cycle(report: RunReport) -> TimerStatus:
    (cycle,) = report.component(_NAVIGATOR).timers
    return cycle


def _missed(report: RunReport) -> float:
    """Return the share of the navigator's 200 ms deadlines that were missed."""
    cycle = _navigators_cycle(report)
    return cycle.missed / cycle.releases if cycle.releases else 1.0


def _is_at_goal(report: RunReport) -> bool:
    return bool(report.simulation.get("goal_reached"))


def _failed(report: RunReport) -> list[str]:
    """Return the functions that did not work, as the world saw it."""
    functions = report.simulation.get("functions", {})
    return [name for name, works in functions.items() if not works]


def _outcome(report: RunReport) -> str:
    if report.invalid:
        return f"[yellow]invalid run:[/] {report.invalid}"
    reached = "reached its goal" if _is_at_goal(report) else "did not reach its goal"
    return (
        f"the robot {reached} in {report.seconds:.1f} s; the navigator missed "
        f"{_missed(report):.1%} of its deadlines"
    )


def move_while_driving(
    examples: Path, console: Console, check: Check = nothing
) -> Scene:
    """Let the robot drive, move its localiser in mid-drive, and tell how it went."""
    console.print("\n[bold]T-Rot's localiser moves while it drives")
    robot = load(examples / "trot" / "robot.yaml", say=console.print)
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
        self._report: MoveReport | None = None
        self._ended = 0.0
        self._counts: list[tuple[int, int]] = [(0, 0)]

    def look(self, run: Run, now: float) -> None:
        """Move when it is time; `now` is since the start of the drive [s]."""
        if self._report is None and now > _MOVE_AT:
            self._counts.append(_deadlines(run))
            self._report = move(run, _MOVED, self._target)
            self._ended = now + self._report.prepared + self._report.downtime
        elif len(self._counts) == _COUNTS_BEFORE_END and now > self._ended + 1:
            self._counts.append(_deadlines(run))

    def scene(self, report: RunReport) -> Scene:
        """Return what came of it."""
        if self._report is None:
            raise RunError(
                f"the drive ended before {_MOVE_AT:g} s: {report.simulation}"
            )
        cycle = _navigators_cycle(report)
        counts = [*self._counts, (cycle.missed, cycle.releases)]
        parts = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(counts)]
        before, during, after = (*parts, (0, 0))[:3]
        return Scene(
            move=self._report,
            before=before,
            during=during,
            after=after,
            goal_reached=_is_at_goal(report),
            invalid=report.invalid,
        )


def _deadlines(run: Run) -> tuple[int, int]:
    """Return how many deadlines the navigator missed so far, and how many it had."""
    for component in components_of(run.agents.statuses()):
        if component.name == _NAVIGATOR:
            (cycle,) = component.timers
            return cycle.missed, cycle.releases
    raise RunError(f"component '{_NAVIGATOR}' is gone")


def told(scene: Scene) -> str:
    """Return what happened, for people."""
    report = scene.move
    if not report.committed:
        return f"[yellow]{escape(outcome_sentence(report))}[/]"
    parts = ("before", scene.before), ("during", scene.during), ("after", scene.after)
    missed = ", ".join(f"{name} {m} of {of}" for name, (m, of) in parts)
    return (
        f"{_MOVED} went from {report.source} to {report.target}; downtime "
        f"{format_seconds(report.downtime)}; deadlines missed: {missed}; goal "
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
    with progress(console, _DRIVE, live=True) as show:

        def look(run: Run, now: float) -> None:
            show(run, now)
            meanwhile(run, now)

        report = run(
            robot,
            "serve",
            seconds=_DRIVE,
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


def _calls(examples: Path, console: Console, check: Check) -> dict[str, Summary]:
    console.print("\n[bold]How long calls take")
    robot = load(examples / "calls" / "robot.yaml", say=console.print)
    report = run(robot, "call", seconds=_CALLS, say=console.print, check=check)
    measures = report.component("caller").measures
    return {"direct": measures["near"], "message": measures["far"]}


def _show(report: DemoReport, console: Console) -> None:
    """Print the numbers side by side, a column per run."""
    rows = table("", *(_TITLES[drive.method] for drive in report.runs))
    for computer in report.runs[0].cpu_share:
        shares = [f"{drive.cpu_share.get(computer, 0):.0%}" for drive in report.runs]
        rows.add_row(f"CPU used on {computer}", *shares)
    for label, read in _ROWS.items():
        rows.add_row(label, *(read(drive) for drive in report.runs))
    console.print(rows)
    console.print(told(report.scene))
    direct, message = map(_typical, report.calls.values())
    console.print(
        f"a call to a component beside it: {direct}; to one on the other computer: "
        f"{message}"
    )


def _draw(runs: Sequence[RunReport], console: Console) -> None:
    drives = [
        DrivePicture(
            title=_TITLES[drive.method],
            path=drive.simulation.get("path", ()),
            shares={"deadlines missed": _missed(drive)}
            | {f"CPU of {name}": share for name, share in drive.cpu_share.items()},
            verdict=f"functions that failed: {', '.join(_failed(drive)) or 'none'}",
        )
        for drive in runs
    ]
    home = runs[-1].simulation
    goal = [home["goal"]] if "goal" in home else []
    picture = drives_picture(drives, home.get("walls", ()), goal)
    _PICTURE.write_text(picture, encoding="utf-8")
    console.print(f"both drives are drawn in {_PICTURE.absolute()}")


def _typical(summary: Summary) -> str:
    return f"{format_seconds(summary.median)} (p99 {format_seconds(summary.p99)})"


def _age(report: RunReport, what: str) -> str:
    measures = report.component(_NAVIGATOR).measures
    return _typical(measures.get(f"{what}_age", Summary()))


_ROWS: Mapping[str, Callable[[RunReport], str]] = {
    "200 ms deadlines missed": lambda r: f"{_missed(r):.1%}",
    "age of the pose used, median (p99)": lambda r: _age(r, "pose"),
    "age of the map used, median (p99)": lambda r: _age(r, "map"),
    "goal reached": lambda r: "yes" if _is_at_goal(r) else "no",
    "functions that failed": lambda r: ", ".join(_failed(r)) or "none",
    "time": lambda r: f"{r.seconds:.1f} s",
    "placement decided in": lambda r: (
        format_seconds(r.decision_seconds) if r.decision_seconds else "by hand"
    ),
    "valid run": lambda r: "no" if r.invalid else "yes",
}


def find_trouble(runs: Sequence[RunReport]) -> str:
    """Return what did not come out as in the paper; empty when all did."""
    static, auto = runs
    for drive in runs:
        if drive.invalid:
            return f"the run with {drive.method} placement is invalid: {drive.invalid}"
    if not _failed(static):
        return "all functions worked with static placement; in the paper, one failed"
    if failed := _failed(auto):
        return f"with Poise's placement these failed: {', '.join(failed)}"
    if _missed(auto) >= _MOST_MISSED:
        return "Poise's placement did not meet the navigator's deadlines"
    return ""
