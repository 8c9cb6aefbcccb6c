"""`poise record`: what a running robot needs, decides and says, in an MCAP file."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Annotated

import typer

from poise.cli.command.run_time.running_robot import Robot
from poise.cli.completion import running
from poise.cli.interrupts import Interrupts
from poise.errors import UsageError
from poise.manage.agent_connections.statuses import connectors_of
from poise.session.render.printable import console_to
from poise.session.running_robots.running import connect
from poise.units import counted


def record_command(
    connectors: Annotated[
        list[str] | None,
        typer.Argument(
            help="Whose messages and calls: names, or component.port of an end.",
            autocompletion=running("connectors"),
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The file; else ROBOT-TIME.mcap."),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Messages and calls of all connectors.")
    ] = False,
    rate: Annotated[
        float, typer.Option(help="At most so many messages of each a second.")
    ] = 400.0,
    seconds: Annotated[
        float, typer.Option("--for", help="End after so many seconds.")
    ] = math.inf,
    robot: Robot = None,
) -> None:
    """Record a running robot, until Ctrl-C, as an MCAP file, which Foxglove opens.

    How computers, components, connectors, timers and chains are each second, what the
    manager decides, and the messages and calls of the connectors that are named. The
    robot does not wait for it: what finds no room is counted. It goes on with a new
    manager. The file is whole when this ends, also with an error: with code 1 when the
    disk is full or the robot has ended, with 130 after Ctrl-C.

    Examples
    --------
    poise record

    poise record counter.count --for 60 -o run.mcap
    """
    for option, value in ("--rate", rate), ("--for", seconds):
        if not value > 0:
            raise UsageError(f"{option} {value:g}: it is a positive number")
    try:
        from poise.view.mcap_file import McapFile
        from poise.view.record import Recorder
    except ImportError as error:
        raise UsageError(
            "poise record needs mcap: pip install 'poise[record]'"
        ) from error
    status = connect(robot).status()
    names = connectors or []
    if every:
        names = sorted({end.name for end in connectors_of(status.computers)})
    clock = time.strftime("%Y%m%d-%H%M%S")
    path = output or Path(f"{status.robot}-{clock}.mcap")
    console = console_to()
    with Interrupts() as interrupts:
        recorder = Recorder(status.robot, names, rate)  # before there is a file
        file = McapFile(path)
        try:
            with file:
                console.print(f"recording robot '{status.robot}' to {path}")
                with console.status("") as shown:
                    recorder.record(
                        file,
                        seconds,
                        interrupts.check,
                        console.print,
                        lambda now: shown.update(f"{now:.0f} s: {file.summary()}"),
                    )
        finally:
            console.print(f"{file.summary()} in {path}")
            for connector, count in sorted(recorder.missing.items()):
                console.print(f"{connector}: {counted(count, 'message')} left out")
