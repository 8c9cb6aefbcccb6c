"""`poise up`: start a robot and keep it running."""

from __future__ import annotations

import contextlib
import importlib
import sys
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from poise.cli.commands.dashboard_command import check_dashboard, dashboard_beside
from poise.cli.interrupts import Interrupts
from poise.cli.options import AnyMethod, RobotFile
from poise.errors import UsageError
from poise.model.steps import Prefetch
from poise.session.folders import to_write
from poise.session.launch.printer import Printer, log_printer
from poise.session.robot_file import load, task_of

_LOOK_EVERY = 0.2


def up_command(
    file: RobotFile,
    task: Annotated[
        list[str] | None,
        typer.Option("--task", help="A task, or several; else the file's first."),
    ] = None,
    placement: AnyMethod = None,
    journal: Annotated[
        Path | None,
        typer.Option(help="File for the journal; else `poise journal` finds it."),
    ] = None,
    metrics: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="TCP port for Prometheus, on this computer."
        ),
    ] = None,
    otel: Annotated[
        str | None, typer.Option(help="URL of an OpenTelemetry collector (OTLP/HTTP).")
    ] = None,
    adapt: Annotated[
        bool, typer.Option(help="Change the placement when deadlines are missed.")
    ] = True,
    prefetch: Annotated[
        bool, typer.Option(help="Prepare what the next actions need.")
    ] = True,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="Replace the manager that it has.")
    ] = False,
    detach: Annotated[
        bool, typer.Option("--detach", help="Return once it is up; it goes on.")
    ] = False,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Show it as a web page meanwhile.")
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option(
            help="File for what is used, and what policies see.", callback=to_write
        ),
    ] = None,
) -> None:
    """Start a robot and keep it running until Ctrl-C or `poise stop`.

    With --detach it goes on in the background, and returns once the robot is up.

    Meanwhile `poise status`, `task`, `move`, `replace` and `balance` work on it. It
    prints each move, what its tasks do, and everything that is not as the robot file
    says.

    Example: poise up robot.yaml --task fetch
    """
    if dashboard:
        check_dashboard()
    with Printer() as printer, log_printer():
        say = printer.print
        robot = load(file, say=say, meanwhile=_import_the_rest)
        from poise.session.launch.detached import up_detached
        from poise.session.placing.placement import place
        from poise.session.up import up

        if detach:
            with Interrupts() as interrupts:
                words = [word for word in sys.argv[1:] if word != "--detach"]
                say(str(up_detached(robot, file, words, say, interrupts.check)))
            if dashboard:
                say("its log says where the dashboard is")
            return
        if not prefetch:
            robot = replace(robot, prefetch=Prefetch(off=True))
        tasks = task or [task_of(robot, None)]
        if placement and len(tasks) > 1:
            raise UsageError("--placement places one task: start the others afterwards")
        placed = (
            place(robot, tasks[0], method=placement, fewer=True) if placement else None
        )
        with (
            Interrupts() as interrupts,
            up(
                robot,
                tasks,
                placement=placed,
                journal=journal,
                metrics=metrics,
                otel=otel,
                record=record,
                adapt=adapt,
                take_over=take_over,
                say=say,
                check=interrupts.check,
            ) as running,
            dashboard_beside(robot.name) if dashboard else contextlib.nullcontext(),
        ):
            ends = "Ctrl-C" if sys.stdin.isatty() else "`poise stop`"
            names = "' and '".join(tasks)
            say(f"robot '{robot.name}' is up with task '{names}'; {ends} ends it")
            while not running.wait(_LOOK_EVERY):
                interrupts.check()
            say("stopping")


def _import_the_rest() -> None:
    """Import the manager, so that a robot waits for it no longer than it must."""
    importlib.import_module("poise.session.up")
