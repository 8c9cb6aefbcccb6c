"""`poise check`: every problem of a robot file, and of the code that it names."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from poise.cli.options import AsJson, busy
from poise.errors import FileProblem, UsageError
from poise.session.robot_file import check
from poise.units import counted


def check_command(
    file: Annotated[
        Path | None, typer.Argument(help="The robot file.", envvar="POISE_ROBOT")
    ] = None,
    as_json: AsJson = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of robot files.")
    ] = False,
) -> None:
    """Check a robot file and the code that it names.

    It reports every problem as file:line:column and message. The exit code is 0 when
    there is none.

    Example: poise check robot.yaml
    """
    if schema:
        _print_schema()
        return
    if file is None:
        raise UsageError("give a robot file, as in `poise check robot.yaml`")
    with busy("checking"):
        problems = check(file)
    _print_json(problems) if as_json else _print_text(file, problems)
    if problems:
        raise typer.Exit(1)


def _print_schema() -> None:
    from poise.model.schema import schema_text

    sys.stdout.write(schema_text())


def _print_json(problems: tuple[FileProblem, ...]) -> None:
    report = {"ok": not problems, "problems": msgspec.to_builtins(problems)}
    sys.stdout.write(json.dumps(report, indent=2) + "\n")


def _print_text(path: Path, problems: tuple[FileProblem, ...]) -> None:
    if not problems:
        sys.stdout.write(f"{path}: no problems\n")
        return
    for problem in problems:
        sys.stderr.write(f"{problem}\n")
    sys.stderr.write(f"{path}: {counted(len(problems), 'problem')}\n")
