"""`poise run`: start what a task needs, watch it, and report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.markup import escape

from poise.cli.interrupts import Interrupts
from poise.cli.options import AsJson, Method, RobotFile, RobotTask, parse_option
from poise.errors import UsageError
from poise.session.folders import to_write
from poise.session.placing.placement import place
from poise.session.render.printable import console_to
from poise.session.render.run_progress import progress
from poise.session.robot_file import load, task_of
from poise.session.run import run
from poise.units import SECONDS


def run_command(
    file: RobotFile,
    task: RobotTask = None,
    placement: Method = "auto",
    for_: Annotated[
        str, typer.Option("--for", help="How long at most, such as 20s or 2 min.")
    ] = "20s",
    report: Annotated[
        Path | None,
        typer.Option(help="Folder for report.html, report.json and the journal."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            help="File for what is used, and what architectures publish.",
            callback=to_write,
        ),
    ] = None,
    adapt: Annotated[
        bool,
        typer.Option("--adapt", help="Change the placement as `poise up` does."),
    ] = False,
    allow_errors: Annotated[
        bool,
        typer.Option(
            "--allow-errors", help="Exit with 0 when components had errors, too."
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run a task on the robot's computers; without addresses they are emulated.

    Its actions run in their order. It ends when the task does, or after --for.
    Meanwhile `poise status`, `task`, `move`, `replace` and `balance` work on it.

    What --record keeps can be the `workload` on which `poise profile` measures;
    `poise recording` reads it. The exit code is 1 when a component raised or hung, a
    message was refused, a container ended, the task failed, or the run is invalid.

    Example: poise run robot.yaml --task fetch --for 20s
    """
    seconds = parse_option("--for", for_, SECONDS)
    if not seconds > 0:
        raise UsageError(f"--for {for_}: a run lasts longer than 0 s")
    console = console_to(stderr=as_json)

    def say(sentence: str) -> None:
        console.print(escape(sentence))

    with console.status("checking the robot file and its code ..."):
        robot = load(file, say=say)
    chosen = task_of(robot, task)
    placed = place(robot, chosen, method=placement, fewer=True)
    if report is not None:
        _make_folder(report)
    with Interrupts() as interrupts:
        with progress(console, seconds) as show:
            result = run(
                robot,
                chosen,
                seconds=seconds,
                placement=placed,
                journal=report / "journal.jsonl" if report else None,
                record=record,
                adapt=adapt,
                say=say,
                meanwhile=show,
                check=interrupts.check,
            )
        text = msgspec.json.format(msgspec.json.encode(result))
        if report is not None:
            (report / "report.json").write_bytes(text + b"\n")
            (report / "report.html").write_text(result.page(), encoding="utf-8")
            console.print(escape(f"wrote {report / 'report.html'}"))
        if as_json:
            sys.stdout.write(text.decode() + "\n")
        else:
            console.print(result)
    if result.invalid or (result.failed and not allow_errors):
        raise typer.Exit(1)


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--report {path}: {error.strerror}") from error
    to_write(path / "report.json")
