"""`poise demo`: the paper's case study, with static placement and with Poise's."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from msgspec import Struct
from rich.console import Console

from poise.cli.demo_scene import NAVIGATOR, Scene, move_while_driving, serve, told
from poise.cli.interrupts import interrupts
from poise.errors import RobotError, RunError
from poise.session.placement import place
from poise.session.render.tables import table
from poise.session.report import RunReport
from poise.session.robot_file import load
from poise.session.run import run
from poise.units import format_seconds
from poise.wire.records.deployment import Summary

EXAMPLES = Path(__file__).parents[3] / "examples"

_CALLS = 2.0
_MOST_MISSED = 0.01
"""Share of deadlines that Poise may miss."""
_MOST_MET = 0.5
"""Share of deadlines that static placement may meet, to fail as in the paper."""


class Drive(Struct, frozen=True, kw_only=True):
    """One drive of the robot.

    Parameters
    ----------
    deadline_miss_share
        Share of the navigator's 200 ms deadlines that were missed.
    pose_age, map_age
        Age of pose and map when the navigator used them [s].
    cpu_share
        Computer -> share of its CPU that was used.
    invalid
        Why the drive says nothing about the robot; empty when it does.
    """

    method: str
    deadline_miss_share: float
    pose_age: Summary
    map_age: Summary
    goal_reached: bool
    decision_seconds: float
    cpu_share: Mapping[str, float]
    seconds: float
    placement: Mapping[str, str]
    invalid: str


class Calls(Struct, frozen=True, kw_only=True):
    """How long calls take: in one container, and between two computers [s]."""

    direct: Summary
    message: Summary


class DemoReport(Struct, frozen=True, kw_only=True):
    """All that the demo measured."""

    runs: tuple[Drive, ...]
    scene: Scene
    calls: Calls


def demo_command(
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the numbers as JSON.")
    ] = False,
    examples: Annotated[
        Path, typer.Option(help="The folder with the examples trot and calls.")
    ] = EXAMPLES,
) -> None:
    """Drive a home service robot through a home, placed by hand and by Poise.

    24 components on two emulated computers, as in the paper's case study: first all on
    the main computer, then where Poise puts them. Takes about a minute.

    Example: poise demo
    """
    if not (examples / "trot" / "robot.yaml").is_file():
        raise RobotError(
            f"the demo's robot is not at {examples}: run it in a clone of Poise, or "
            "give its examples folder with --examples"
        )
    console = Console(stderr=as_json, highlight=False)
    with interrupts:
        report = DemoReport(
            runs=(
                _drive(examples, "static", console),
                _drive(examples, "auto", console),
            ),
            scene=move_while_driving(examples, console),
            calls=_calls(examples, console),
        )
    if as_json:
        text = msgspec.json.format(msgspec.json.encode(report))
        sys.stdout.write(text.decode() + "\n")
    else:
        _show(report, console)
    trouble = find_trouble(report.runs)
    if trouble:
        Console(stderr=True).print(trouble)
        raise typer.Exit(1)


def _drive(examples: Path, method: str, console: Console) -> Drive:
    """Drive once; a second time when the host spoilt the first."""
    titles = {"static": "everything on Main", "auto": "where Poise puts it"}
    console.print(f"\n[bold]T-Rot, {titles[method]}")
    robot = load(examples / "trot" / "robot.yaml", say=console.print)
    for _ in range(2):
        report = serve(robot, place(robot, "serve", method=method), console)
        drive = _read_drive(report)
        console.print(_outcome(drive))
        if not drive.invalid:
            break
    return drive


def _read_drive(report: RunReport) -> Drive:
    navigator = report.component(NAVIGATOR)
    (cycle,) = navigator.timers
    if not report.invalid and "goal_reached" not in report.simulation:
        raise RunError(
            f"the simulator's result lacks 'goal_reached': {report.simulation}"
        )
    return Drive(
        method=report.method,
        deadline_miss_share=cycle.missed / cycle.releases if cycle.releases else 1.0,
        pose_age=navigator.measures.get("pose_age", Summary()),
        map_age=navigator.measures.get("map_age", Summary()),
        goal_reached=bool(report.simulation.get("goal_reached")),
        decision_seconds=report.decision_seconds,
        cpu_share=report.cpu_share,
        seconds=report.seconds,
        placement=report.placement,
        invalid=report.invalid,
    )


def _outcome(drive: Drive) -> str:
    if drive.invalid:
        return f"[yellow]invalid run:[/] {drive.invalid}"
    reached = "reached its goal" if drive.goal_reached else "did not reach its goal"
    return (
        f"the robot {reached} in {drive.seconds:.1f} s; the navigator missed "
        f"{drive.deadline_miss_share:.1%} of its deadlines"
    )


def _calls(examples: Path, console: Console) -> Calls:
    console.print("\n[bold]How long calls take")
    robot = load(examples / "calls" / "robot.yaml", say=console.print)
    report = run(
        robot, "call", seconds=_CALLS, say=console.print, check=interrupts.check
    )
    measures = report.component("caller").measures
    return Calls(direct=measures["near"], message=measures["far"])


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
    calls = report.calls
    console.print(
        f"a call to a component beside it: {_typical(calls.direct)}; "
        f"to one on the other computer: {_typical(calls.message)}"
    )


_TITLES = {"static": "static (all on Main)", "auto": "Poise"}


def _typical(summary: Summary) -> str:
    return f"{format_seconds(summary.median)} (p99 {format_seconds(summary.p99)})"


_ROWS: Mapping[str, Callable[[Drive], str]] = {
    "200 ms deadlines missed": lambda d: f"{d.deadline_miss_share:.1%}",
    "age of the pose used, median (p99)": lambda d: _typical(d.pose_age),
    "age of the map used, median (p99)": lambda d: _typical(d.map_age),
    "goal reached": lambda d: "yes" if d.goal_reached else "no",
    "time": lambda d: f"{d.seconds:.1f} s",
    "placement decided in": lambda d: (
        format_seconds(d.decision_seconds) if d.decision_seconds else "by hand"
    ),
    "valid run": lambda d: "no" if d.invalid else "yes",
}


def find_trouble(runs: Sequence[Drive]) -> str:
    """Return what did not come out as in the paper; empty when all did."""
    by_method = {drive.method: drive for drive in runs}
    static, auto = by_method["static"], by_method["auto"]
    for drive in runs:
        if drive.invalid:
            return f"the run with {drive.method} placement is invalid: {drive.invalid}"
    if static.goal_reached or static.deadline_miss_share < 1 - _MOST_MET:
        return "static placement did not fail as it does in the paper"
    if not auto.goal_reached or auto.deadline_miss_share >= _MOST_MISSED:
        return "Poise's placement did not meet the navigator's deadlines"
    return ""
