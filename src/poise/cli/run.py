"""`poise run`: start what a task needs, watch it, and report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console

from poise.cli.render.progress import progress
from poise.cli.render.run import show_run
from poise.errors import UsageError
from poise.session.launch import Kind, decide, first_task, prepared, run_task
from poise.session.writable import to_write
from poise.units import SECONDS, parse


def run_command(
    file: Annotated[Path, typer.Argument(help="The robot file.")],
    task: Annotated[
        str | None, typer.Option(help="The task; else the file's first.")
    ] = None,
    placement: Annotated[
        Kind, typer.Option(help="auto: Poise decides; static: home computers.")
    ] = "auto",
    for_: Annotated[
        str, typer.Option("--for", help="How long, such as 20s or 2 min.")
    ] = "20s",
    report: Annotated[
        Path | None, typer.Option(help="Folder for report.json and the journal.")
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            help="File for what is used, and what architectures publish.",
            callback=to_write,
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the report as JSON.")
    ] = False,
) -> None:
    """Run a task on the robot's computers; without addresses they are emulated.

    What --record keeps can be the `workload` on which `poise profile` measures;
    `poise recording` reads it.

    Example: poise run robot.yaml --task fetch --for 20s
    """
    seconds = _seconds(for_)
    console = Console(stderr=as_json, highlight=False)
    robot = prepared(file, console.print)
    chosen = task or first_task(robot)
    decision = decide(robot, chosen, placement)
    if report is not None:
        _make_folder(report)
    with progress(console, seconds) as show:
        result = run_task(
            robot,
            chosen,
            decision,
            seconds=seconds,
            say=console.print,
            report=report,
            record=record,
            meanwhile=show,
        )
    text = msgspec.json.format(msgspec.json.encode(result))
    if report is not None:
        (report / "report.json").write_bytes(text + b"\n")
    if as_json:
        sys.stdout.write(text.decode() + "\n")
    else:
        show_run(result, console)
    if result.void:
        raise typer.Exit(1)


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--report {path}: {error.strerror}") from error
    to_write(path / "report.json")


def _seconds(text: str) -> float:
    try:
        seconds = parse(text, SECONDS)
    except ValueError as error:
        raise UsageError(f"--for {text}: {error}") from error
    if not seconds > 0:
        raise UsageError(f"--for {text}: a run lasts longer than 0 s")
    return seconds
