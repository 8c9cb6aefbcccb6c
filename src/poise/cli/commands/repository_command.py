"""`poise repository`: which architectures provide which function, and how well."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from msgspec import structs
from rich.console import Console
from rich.markup import escape

from poise.cli.options import AsJson, RobotFile, print_json
from poise.errors import UsageError
from poise.estimate.success.learning import Belief, beliefs_about, forget
from poise.model.load import load
from poise.session.placing.chosen_architectures import Described, Listed, listed
from poise.session.render.printable import console_to
from poise.session.render.tables import table
from poise.suggest import unknown
from poise.units import counted

AnyFile = Annotated[
    Path | None,
    typer.Argument(
        envvar="POISE_ROBOT",
        help="The robot file; without it, only installed packages are searched.",
    ),
]
Name = Annotated[str, typer.Argument(help="The architecture.")]


def list_command(file: AnyFile = None, as_json: AsJson = False) -> None:
    """List the architectures that a robot may choose from, by function.

    They are from its file, from the folders of its `repository`, and from installed
    packages.

    Examples
    --------
    poise repository list robot.yaml
    """
    rows = listed(file)
    if as_json:
        print_json(rows)
    elif rows:
        _show_list(rows, console_to())
    else:
        console_to().print(
            "no installed package has the entry point poise.architectures"
        )


def show_command(name: Name, file: AnyFile = None, as_json: AsJson = False) -> None:
    """Show an architecture, and how often actions succeeded with it.

    Examples
    --------
    poise repository show laser_navigator robot.yaml
    """
    rows = listed(file)
    row = next((row for row in rows if row.architecture == name), None)
    if row is None:
        names = [row.architecture for row in rows]
        raise UsageError(unknown("architecture", name, names))
    beliefs = [] if file is None or row.unused else beliefs_about(load(file), name)
    if as_json:
        print_json(Described(**structs.asdict(row), learned=tuple(beliefs)))
    else:
        _show(row, beliefs, console_to())


def reset_command(name: Name, file: RobotFile) -> None:
    """Forget how often actions succeeded with an architecture.

    Examples
    --------
    poise repository reset laser_navigator robot.yaml
    """
    count = forget(load(file), name)
    console_to().print(f"{counted(count, 'outcome')} of '{name}' forgotten")


def _show_list(rows: list[Listed], console: Console) -> None:
    shown = table("function", "architecture", "quality", "hash", "from", folds=4)
    for row in rows:
        source = f"{row.where} ({row.package})" if row.package else row.where
        unused = f"\nnot used: {row.unused}" if row.unused else ""
        quality = f"{row.quality:g}"
        where = escape(source + unused)
        shown.add_row(row.function, row.architecture, quality, row.hash, where)
    console.print(shown)


def _show(row: Listed, beliefs: list[Belief], console: Console) -> None:
    what = f"{row.architecture} provides {row.function}"
    for sentence in (
        f"{what}, quality {row.quality:g}, {row.layer} layer",
        f"from {row.where}" + (f", package {row.package}" if row.package else ""),
        f"hash {row.hash}",
        f"components: {', '.join(row.components)}",
        *((f"not used: {row.unused}",) if row.unused else ()),
    ):
        console.print(escape(sentence), highlight=False)
    if not beliefs:
        console.print("nothing is learned of its success yet")
        return
    shown = table(
        "action", "conditions", "success", "90 % between", "of", "hash", folds=1
    )
    for each in beliefs:
        shown.add_row(
            each.action,
            str(each.conditions),
            f"{each.mean:.0%} ± {each.deviation:.0%}",
            f"{each.low:.0%} and {each.high:.0%}",
            str(each.done + each.failed),
            each.hash if each.is_present else f"{each.hash}, before",
        )
    console.print(shown)


repository_command = list_command
