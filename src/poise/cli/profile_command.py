"""`poise profile` and `calibrate`: measure components, computers and connectors."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from poise.cli.main import Interrupts
from poise.cli.options import AsJson, RobotFile, Set, arguments_of, parse_option, show
from poise.errors import RobotError, RunError
from poise.estimate.demands import overheads
from poise.estimate.profiles import Profile
from poise.model.robot import Robot
from poise.session.folders import to_write
from poise.session.profiling.calibrate import Calibration, calibrate
from poise.session.profiling.profile_robot import Profiling, Tick, profile
from poise.session.profiling.stored_profiles import (
    kept_profiles,
    own_profile,
    stale,
    write_demands,
)
from poise.session.render.printable import SafeConsole, console_to
from poise.session.render.profile_tables import history_table, profile_parts
from poise.session.render.tables import table
from poise.session.robot_file import load_bare
from poise.units import SECONDS

Write = Annotated[
    bool, typer.Option("--write", help="Also write the demands into the robot file.")
]


def profile_command(
    file: RobotFile,
    architecture: Annotated[
        list[str] | None, typer.Option(help="Measure only this one; may be repeated.")
    ] = None,
    for_: Annotated[
        str, typer.Option("--for", help="How long to measure each time.")
    ] = "30s",
    warm_up: Annotated[str, typer.Option(help="How long to run before.")] = "3s",
    on: Annotated[
        str | None, typer.Option(help="The computer to measure on; else the first.")
    ] = None,
    repeat: Annotated[
        int, typer.Option(min=1, help="How often to measure each architecture.")
    ] = 2,
    write: Write = False,
    set_: Set = None,
    as_json: AsJson = False,
) -> None:
    """Measure what each component needs, every architecture alone on one computer.

    The result goes into the profile that the robot file names, for `poise plan` and
    all others, and into a store beside it that keeps older ones. A component that got
    no messages at a subscribed port is not recorded; the exit code is then 1.
    `poise profile show robot.yaml` shows the last profile.

    Example: poise profile robot.yaml --for 30s
    """
    console = console_to(stderr=as_json)
    robot = load_bare(file, arguments_of(set_))
    with Interrupts() as interrupts:
        measured = profile(
            robot,
            architectures=architecture or (),
            computer=on,
            seconds=parse_option("--for", for_, SECONDS),
            warm_up=parse_option("--warm-up", warm_up, SECONDS),
            repeat=repeat,
            say=console.warn,
            progress=partial(_progress, console),
            check=interrupts.check,
        )
    _print(robot, measured.profile, console, as_json=as_json)
    if measured.file:
        console.say(f"written to {measured.file}")
    else:
        console.say(
            "kept in the store, where the planner does not look: `poise profile show "
            f"{file} --write` writes the demands into the robot file; "
            "with `profile: profile.yaml` in it, the next profile is the planner's, too"
        )
    if write:
        _write(file, measured.profile, console)
    _report_silence(measured, console)
    if measured.unrecorded:
        raise typer.Exit(1)


def show_command(
    file: RobotFile,
    write: Write = False,
    plot: Annotated[
        Path | None,
        typer.Option(help="Draw it into a .svg, .png or .pdf file.", callback=to_write),
    ] = None,
    history: Annotated[
        bool, typer.Option("--history", help="Show it beside earlier profiles.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show the last profile, and measure nothing.

    Example: poise profile show robot.yaml --history --plot profile.svg
    """
    console = console_to(stderr=as_json)
    robot = load_bare(file)
    last = own_profile(robot)
    earlier = kept_profiles(robot) if history or last is None else []
    last = last or next(iter(earlier), None)
    if last is None:
        raise RobotError(
            f"robot '{robot.name}' has no profile: `poise profile {file}` measures it"
        )
    _print(robot, last, console, as_json=as_json)
    if history:
        console.print(history_table(last, earlier))
    if plot is not None:
        from poise.view.profile_plot import plot_profile

        plot_profile(last, overheads(robot, last), plot)
        console.say(f"drawn to {plot}")
    if write:
        _write(file, last, console)


def _print(
    robot: Robot, shown: Profile, console: SafeConsole, *, as_json: bool
) -> None:
    show(shown, profile_parts(robot, shown), as_json=as_json)
    old = stale(robot, shown)
    if old and not as_json:
        console.warn(f"changed since it was measured: {', '.join(old)}")


def _write(file: Path, shown: Profile, console: SafeConsole) -> None:
    changed = write_demands(file, shown)
    files = ", ".join(map(str, changed)) or "no file"
    console.say(f"demands written to {files}")


def _report_silence(measured: Profiling, console: SafeConsole) -> None:
    for component, ports in measured.silent.items():
        doubt = component in measured.unrecorded
        for port in ports:
            console.warn(
                f"port '{port}' of component '{component}' got nothing during the "
                f"measurement{'; its figures are discarded' if doubt else ''}"
            )
    if measured.unrecorded:
        console.warn(f"not recorded: {', '.join(measured.unrecorded)}")
    if not measured.silent.keys().isdisjoint(measured.unrecorded):
        console.warn(
            "Connect what sends to these ports, or let the robot file generate "
            "messages for them (`workload: {generate: ...}`)"
        )


@contextlib.contextmanager
def _progress(console: Console, architecture: str, seconds: float) -> Iterator[Tick]:
    """Show a bar for `seconds` [s] on a console."""
    console.print(f"measuring {architecture}")
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True) as bars:
        bar = bars.add_task(architecture, total=seconds)
        yield lambda passed: bars.advance(bar, passed)


def calibrate_command(
    file: RobotFile,
    reference: Annotated[
        str | None,
        typer.Option(help="The computer that speeds are relative to; else the first."),
    ] = None,
    for_: Annotated[
        str, typer.Option("--for", help="How long to measure each time.")
    ] = "8s",
    force: Annotated[
        bool, typer.Option("--force", help="Write the result of a busy machine, too.")
    ] = False,
    set_: Set = None,
    as_json: AsJson = False,
) -> None:
    """Measure how fast the robot's computers are, and what its connectors cost.

    Speeds are relative to the reference computer, for `speed` in the robot file. An
    emulated computer is as fast as this machine. Costs of connectors go into the
    profile; the planner derives overheads from them. If a computer was too busy, the
    result is not written and the exit code is 1.

    Example: poise calibrate robot.yaml
    """
    console = console_to(stderr=as_json)
    robot = load_bare(file, arguments_of(set_))
    seconds = parse_option("--for", for_, SECONDS)
    console.print(f"calibrating for {2 * seconds:g} s, and a few more to start")
    with Interrupts() as interrupts, console.status("") as shown:
        began = time.monotonic()

        def check() -> None:
            interrupts.check()
            shown.update(f"measuring for {time.monotonic() - began:.0f} s")

        result = calibrate(
            robot, reference=reference, seconds=seconds, force=force, check=check
        )
    tables = _speed_table(robot, result), _cost_table(result)
    show(result, tables, as_json=as_json)
    reasons = "; ".join(result.busy)
    if not result.kept:
        raise RunError(f"not written: {reasons}. `--force` writes the result anyway")
    if reasons:
        console.warn(reasons)
    console.print("written to the store, and to the profile if there is one")


def _speed_table(robot: Robot, result: Calibration) -> Table:
    rows = table("computer", "loops per CPU second", "speed measured", "in the file")
    for computer in robot.hosts:
        calibrated = result.computers[computer.name]
        measured = "emulated" if calibrated.speed is None else f"{calibrated.speed:.2f}"
        rows.add_row(
            computer.name, f"{calibrated.loops:.0f}", measured, f"{computer.speed:g}"
        )
    return rows


def _cost_table(result: Calibration) -> Table:
    rows = table("connector", "end", "per call", "per message", "per kB")
    for kind, both in result.costs.items():
        for end, cost in (("source", both.source), ("target", both.target)):
            if kind == "direct" and end == "target":
                continue  # in the same process as the source
            rows.add_row(
                kind,
                "both" if kind == "direct" else end,
                f"{cost.call * 1e6:.0f} µs",
                f"{cost.message * 1e6:.0f} µs",
                f"{cost.byte * 1e9:.2f} µs",
            )
    return rows
