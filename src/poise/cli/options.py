"""Arguments and options that several commands have."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from poise.errors import RunError, UsageError
from poise.units import SECONDS, Dimension, parse

if TYPE_CHECKING:
    from rich.console import RenderableType

    from poise.session.running_robots.local_robots import Thing

Complete = Callable[[typer.Context, str], list[str]]


def running(what: Thing) -> Complete:
    """Return what completes the names of things of robots that run here."""

    def complete(context: typer.Context, begun: str) -> list[str]:
        from poise.session.running_robots.local_robots import names_of, robots_here

        robot = None if what == "robots" else context.params.get("robot")
        return _fitting(lambda: names_of(robots_here(robot), what), begun)

    return complete


def in_file(what: str) -> Complete:
    """Return what completes names in the command's robot file."""

    def complete(context: typer.Context, begun: str) -> list[str]:
        def names() -> Iterable[str]:
            from poise.model import load

            # before an option without a value, arguments are not told from the rest
            robot = load(Path(context.params.get("file") or context.args[0]))
            if what == "tasks":
                return [task.name for task in robot.tasks]
            if what == "computers":
                return [computer.name for computer in robot.computers]
            return [component.name for component in robot.components()]

        return _fitting(names, begun)

    return complete


def _fitting(names: Callable[[], Iterable[str]], begun: str) -> list[str]:
    """Return the names that begin so; none where the line is not one that works yet."""
    from poise.errors import PoiseError

    try:
        return sorted({name for name in names() if name.startswith(begun)})
    except (PoiseError, OSError, IndexError):
        return []


RobotFile = Annotated[
    Path, typer.Argument(help="The robot file.", envvar="POISE_ROBOT")
]
RobotTask = Annotated[
    str | None,
    typer.Option(
        "--task",
        help="The task. Default: the file's first.",
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
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A value for an argument of the robot file; may be repeated.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")]


def arguments_of(words: list[str] | None) -> dict[str, str]:
    """Return what `--set` says: argument -> value."""
    arguments = {}
    for word in words or ():
        name, equals, value = word.partition("=")
        if not (name and equals):
            raise UsageError(f"--set {word}: write NAME=VALUE, as in --set side=left")
        arguments[name] = value
    return arguments


def print_json(outcome: object) -> None:
    """Print one JSON object."""
    sys.stdout.write(msgspec.json.encode(outcome).decode() + "\n")


def as_yaml(value: object) -> str:
    """Return plain data for people, as YAML."""
    import yaml

    text = yaml.safe_dump(value, sort_keys=False, allow_unicode=True)
    return text.removesuffix("...\n")


def positive_seconds(text: str, what: str) -> float:
    """Return how long `what` is to last by `--for` [s]; UsageError: not above 0."""
    seconds = parse_option("--for", text, SECONDS)
    if not seconds > 0:
        raise UsageError(f"--for {text}: {what} must last longer than 0 s")
    return seconds


def show(outcome: object, parts: Iterable[RenderableType], *, as_json: bool) -> None:
    """Print an outcome, as JSON or in parts for people."""
    from poise.session.render.printable import console_to

    if as_json:
        print_json(outcome)
        return
    console = console_to()
    for part in parts:
        console.print(part)


def try_write(path: Path, text: str, say: Callable[[str], object]) -> bool:
    """Write a file, and say so, or why not: its outcome is printed all the same."""
    from poise.session.folders import write_whole

    try:
        write_whole(path, text)
    except RunError as error:
        say(str(error))
        return False
    say(f"wrote {path}")
    return True


def busy(what: str) -> AbstractContextManager[object]:
    """Show in a terminal, on standard error, what a command does for so long."""
    from rich.console import Console

    return Console(stderr=True, highlight=False).status(f"{what} ...")


def parse_option(option: str, text: str | float, dimension: Dimension) -> float:
    """Return the quantity that an option was given, in SI."""
    try:
        return parse(text, dimension)
    except ValueError as error:
        raise UsageError(f"{option} {text}: {error}") from error
