"""`poise recording`: look into what was recorded of a run."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from poise.cli.options import AsJson, print_json
from poise.errors import UsageError
from poise.manage.observe.estimates import DemandEstimate
from poise.session.recordings.recorded_run import RecordedRun
from poise.session.render.printable import console_to
from poise.session.render.tables import table
from poise.session.robot_file import load_bare
from poise.session.state_folder import to_write


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
        typer.Option(help="For export: what the rows are of."),
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
    poise recording export run.recording --to run.parquet
    poise recording replay run.recording --robot robot.yaml
    """
    recorded = RecordedRun(file)
    if what == "export":
        if to is None:
            raise UsageError("give a file: --to run.csv or --to run.parquet")
        count = recorded.export(to, of)
        sys.stdout.write(f"{count} rows of {of} in {to}\n")
        return
    if robot is None:
        raise UsageError("give the robot file: --robot robot.yaml")
    console = console_to(stderr=as_json)
    demand_estimates = recorded.replay(
        load_bare(robot), say=lambda sentence: console.print(f"[yellow]{sentence}[/]")
    )
    if as_json:
        print_json(demand_estimates)
    else:
        _show(demand_estimates, console)


def _show(demand_estimates: list[DemandEstimate], console: Console) -> None:
    rows = table("component", "computer", "CPU", "p95", "profile", folds=1)
    for each in demand_estimates:
        now = each.estimate
        error = f" ± {now.error:.1%}" if now.error is not None else ""
        expected = "" if each.expected is None else f"{each.expected:.1%}"
        mean, p95 = f"{now.mean:.1%}{error}", f"{now.p95:.1%}"
        rows.add_row(each.component, each.computer, mean, p95, expected)
    console.print(rows)
