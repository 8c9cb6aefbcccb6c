"""`poise record` and `poise recording`: make recordings, and look into them."""

from __future__ import annotations

import math
import sys
import time
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from poise.cli.main import Interrupts
from poise.cli.options import AsJson, positive_seconds, print_json, running, show
from poise.cli.running_robot_command import Robot
from poise.errors import UsageError
from poise.manage.observe.estimates import DemandEstimate
from poise.session.folders import to_write
from poise.session.recorded_run import RecordedRun
from poise.session.render.printable import console_to
from poise.session.render.tables import table
from poise.session.robot_file import load_bare
from poise.session.running_robots.playback import CALLS, play
from poise.session.running_robots.running import connect
from poise.units import counted
from poise.view.robot_recording import record


def recording_command(
    what: Annotated[
        Literal["export", "replay"],
        typer.Argument(help="export: to a table; replay: into the estimator."),
    ],
    file: Annotated[Path, typer.Argument(help="The recording.")],
    to: Annotated[
        Path | None,
        typer.Option(help="For export: a .csv or .parquet file.", callback=to_write),
    ] = None,
    of: Annotated[
        Literal["components", "connectors"],
        typer.Option(help="For export: what each row is about."),
    ] = "components",
    robot: Annotated[
        Path | None,
        typer.Option(envvar="POISE_ROBOT", help="For replay: the robot file."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Turn a recording into a table, or estimate again from what it holds.

    `poise run --record FILE` and `poise up --record FILE` make recordings. A replay
    says what the robot's components needed at the end, against its profile, and when
    a demand shifted.

    Examples
    --------
    poise recording export run.mcap --to run.parquet
    poise recording replay run.mcap --robot robot.yaml
    """
    recorded = RecordedRun(file)
    if what == "export":
        if to is None:
            raise UsageError("give a file: --to run.csv or --to run.parquet")
        if as_json:
            raise UsageError("--json goes with replay: export writes a table")
        count = recorded.export(to, of)
        sys.stdout.write(f"{count} rows of {of} in {to}\n")
        return
    if robot is None:
        raise UsageError("give the robot file: --robot robot.yaml")
    console = console_to(stderr=as_json)
    demand_estimates = recorded.replay(load_bare(robot), say=console.warn)
    show(demand_estimates, [_estimate_table(demand_estimates)], as_json=as_json)


def _estimate_table(demand_estimates: list[DemandEstimate]) -> Table:
    rows = table("component", "computer", "CPU", "p95", "profile", folds=1)
    for demand in demand_estimates:
        now = demand.estimate
        error = f" ± {now.error:.1%}" if now.error is not None else ""
        expected = "" if demand.expected is None else f"{demand.expected:.1%}"
        mean, p95 = f"{now.mean:.1%}{error}", f"{now.p95:.1%}"
        rows.add_row(demand.component, demand.computer, mean, p95, expected)
    return rows


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
        bool, typer.Option("--all", help="All connectors, also those that begin later.")
    ] = False,
    rate: Annotated[
        float, typer.Option(help="The most messages of each connector in a second.")
    ] = 400.0,
    for_: Annotated[
        str | None,
        typer.Option("--for", help="How long, such as 60s; else until Ctrl-C."),
    ] = None,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Record a running robot, until Ctrl-C, as an MCAP file, which Foxglove opens.

    How computers, components, connectors, timers and chains are each second, what the
    manager decides, and the messages and calls of the connectors that are named. The
    robot does not wait for it: what finds no room is counted. It goes on with a new
    manager. The file is whole when this ends, also with an error: with code 1 when the
    disk is full or the robot has ended, with 4 when it had no manager for 10 s, with
    130 after Ctrl-C.

    Examples
    --------
    poise record

    poise record counter.count --for 60s -o run.mcap
    """
    if not rate > 0:
        raise UsageError(f"--rate {rate:g}: must be a positive number")
    seconds = math.inf if for_ is None else positive_seconds(for_, "a recording")
    status = connect(robot).status()
    clock = time.strftime("%Y%m%d-%H%M%S")
    path = output or Path(f"{status.robot}-{clock}.mcap")
    console = console_to(stderr=as_json)
    ends = "" if math.isinf(seconds) else f" of {seconds:g} s"
    with Interrupts() as interrupts:
        with console.status("") as shown:
            recorded = record(
                path,
                connectors or (),
                every=every,
                robot=status.robot,
                seconds=seconds,
                rate=rate,
                say=console.say,
                check=interrupts.check,
                tell=lambda now, what: shown.update(f"{now:.0f} s{ends}: {what}"),
            )
        if as_json:
            print_json(recorded)


def play_command(
    file: Annotated[Path, typer.Argument(help="A file of `poise record`.")],
    rate: Annotated[
        float, typer.Option(help="Speed: 2 plays it twice as fast as it was recorded.")
    ] = 1.0,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COMPONENT.PORT", help="Only this connector; may be repeated."
        ),
    ] = None,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Publish the messages of a recording in a running robot, at their ports, in time.

    They come beside what the components publish themselves; calls are not played. It
    exits with 1 when a port could not be played, and says why.

    Examples
    --------
    poise play run.mcap

    poise play run.mcap --rate 2 --only camera.picture
    """
    say = partial(console_to(stderr=as_json).print, markup=False, soft_wrap=True)
    with Interrupts() as interrupts:
        played = play(
            file,
            robot=robot,
            rate=rate,
            only=only or (),
            say=say,
            check=interrupts.check,
        )
    if as_json:
        print_json(played)
    else:
        for port, count in sorted(played.messages.items()):
            say(f"{port}: {counted(count, 'message')}")
        if played.behind > _LATE:
            late = f"the last one was {played.behind:.1f} s late"
            say(f"{late}: play it with a lower --rate")
    if any(why != CALLS for why in played.skipped.values()):
        raise typer.Exit(1)


_LATE = 0.5
"""What is later [s] than in the recording is said."""
