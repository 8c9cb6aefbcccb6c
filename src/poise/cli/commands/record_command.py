"""`poise record`: what a running robot needs, decides and says, in an MCAP file."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from poise.cli.commands.running_robot_command import Robot
from poise.cli.interrupts import Interrupts
from poise.cli.options import AsJson, print_json, running
from poise.errors import UsageError
from poise.manage.agent_connections.statuses import connectors_of
from poise.session.render.printable import console_to
from poise.session.running_robots.running import connect
from poise.view.robot_recording import record


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
    as_json: AsJson = False,
) -> None:
    """Record a running robot, until Ctrl-C, as an MCAP file, which Foxglove opens.

    How computers, components, connectors, timers and chains are each second, what the
    manager decides, and the messages and calls of the connectors that are named. The
    robot does not wait for it: what finds no room is counted, and so is what is too
    long: of lists over 1,000 values, of arrays and of bytes. It goes on with a new
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
    status = connect(robot).status()
    names = connectors or []
    if every:
        names = sorted({end.name for end in connectors_of(status.computers)})
    clock = time.strftime("%Y%m%d-%H%M%S")
    path = output or Path(f"{status.robot}-{clock}.mcap")
    console = console_to(stderr=as_json)
    ends = "" if math.isinf(seconds) else f" of {seconds:g} s"
    with Interrupts() as interrupts:
        with console.status("") as shown:
            recorded = record(
                path,
                names,
                robot=status.robot,
                seconds=seconds,
                rate=rate,
                say=lambda sentence: console.print(escape(sentence)),
                check=interrupts.check,
                tell=lambda now, what: shown.update(f"{now:.0f} s{ends}: {what}"),
            )
        if as_json:
            print_json(recorded)
