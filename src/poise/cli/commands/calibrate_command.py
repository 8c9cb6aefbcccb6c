"""`poise calibrate`: measure computers' speeds and what connectors cost."""

from __future__ import annotations

import time
from typing import Annotated

import typer
from rich.table import Table

from poise.cli.interrupts import Interrupts
from poise.cli.options import AsJson, RobotFile, parse_option, print_json
from poise.errors import RunError
from poise.model.robot import Robot
from poise.session.profiling.calibrate import Calibration, calibrate
from poise.session.render.printable import console_to
from poise.session.render.tables import table
from poise.session.robot_file import load_bare
from poise.units import SECONDS


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
    robot = load_bare(file)
    seconds = parse_option("--for", for_, SECONDS)
    console.print(f"calibrating for {2 * seconds:g} s, and a few more to start")
    with Interrupts() as interrupts, console.status("") as shown:
        began = time.monotonic()

        def check() -> None:
            interrupts.check()
            shown.update(f"measuring since {time.monotonic() - began:.0f} s")

        result = calibrate(
            robot, reference=reference, seconds=seconds, force=force, check=check
        )
    if as_json:
        print_json(result)
    else:
        console.print(_speed_table(robot, result))
        console.print(_cost_table(result))
    reasons = "; ".join(result.busy)
    if not result.kept:
        raise RunError(f"not written: {reasons}. `--force` writes the result anyway")
    if reasons:
        console.print(f"[yellow]{reasons}[/]")
    console.print("written to the store, and to the profile if there is one")


def _speed_table(robot: Robot, result: Calibration) -> Table:
    rows = table("computer", "loops per CPU second", "speed measured", "in the file")
    for computer in robot.computers:
        found = result.computers[computer.name]
        measured = "emulated" if found.speed is None else f"{found.speed:.2f}"
        rows.add_row(
            computer.name, f"{found.loops:.0f}", measured, f"{computer.speed:g}"
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
