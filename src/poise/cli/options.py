"""Arguments and options that several commands have."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from poise.cli.completion import in_file
from poise.errors import UsageError
from poise.units import Dimension, parse

RobotFile = Annotated[
    Path, typer.Argument(help="The robot file.", envvar="POISE_ROBOT")
]
RobotTask = Annotated[
    str | None,
    typer.Option(
        "--task",
        help="The task; else the file's first.",
        autocompletion=in_file("tasks"),
    ),
]
_PLACEMENT = typer.Option(
    "--placement",
    help="auto, greedy: Poise decides; static: home computers; round-robin; "
    "whole-functions; "
    "random:SEED; or a file with `component: computer`.",
)
Method = Annotated[str, _PLACEMENT]
AnyMethod = Annotated[str | None, _PLACEMENT]
"""None: what runs stays where it is, and Poise decides about the rest."""
AsJson = Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")]


def print_json(outcome: object) -> None:
    """Print one JSON object."""
    sys.stdout.write(msgspec.json.encode(outcome).decode() + "\n")


def busy(what: str) -> AbstractContextManager[object]:
    """Show in a terminal, on standard error, what a command does for so long."""
    from rich.console import Console

    return Console(stderr=True, highlight=False).status(f"{what} ...")


def parse_option(option: str, text: str, dimension: Dimension) -> float:
    """Return the quantity that an option was given, in SI.

    Raises
    ------
    UsageError
        It is none; the message names the option and the accepted units.
    """
    try:
        return parse(text, dimension)
    except ValueError as error:
        raise UsageError(f"{option} {text}: {error}") from error
