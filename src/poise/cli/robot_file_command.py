"""Robot files: `poise check`, `policy` and `repository`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import typer
from msgspec import structs
from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table

import poise
from poise.cli.options import AsJson, RobotFile, Set, arguments_of, busy, show
from poise.errors import FileProblem, UsageError, unknown
from poise.estimate.outcomes import forget
from poise.estimate.success_rates import beliefs_about
from poise.model.loading import load
from poise.model.policy import Policy, policies_of
from poise.session.render.printable import console_to
from poise.session.render.tables import table
from poise.session.robot_file import Described, Listed, check, listed, notes
from poise.units import counted, format_seconds


def check_command(
    file: Annotated[
        Path | None, typer.Argument(help="The robot file.", envvar="POISE_ROBOT")
    ] = None,
    set_: Set = None,
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
        from poise.model.schema import schema_text

        sys.stdout.write(schema_text())
        return
    if file is None:
        raise UsageError("give a robot file, as in `poise check robot.yaml`")
    with busy("checking"):
        arguments = arguments_of(set_)
        problems = check(file, arguments)
    said = () if problems else notes(load(file, arguments))
    if as_json:
        _print_json(problems, said)
    else:
        _print_text(file, problems, said)
    if problems:
        raise typer.Exit(1)


def _print_json(problems: tuple[FileProblem, ...], notes: tuple[str, ...]) -> None:
    report = {
        "ok": not problems,
        "problems": msgspec.to_builtins(problems),
        "notes": notes,
    }
    sys.stdout.write(json.dumps(report, indent=2) + "\n")


def _print_text(
    path: Path, problems: tuple[FileProblem, ...], notes: tuple[str, ...]
) -> None:
    if not problems:
        sys.stdout.write("\n".join((f"{path}: no problems", *notes, "")))
        return
    for problem in problems:
        sys.stderr.write(f"{problem}\n")
    sys.stderr.write(f"{path}: {counted(len(problems), 'problem')}\n")


def policy_command(
    what: Annotated[
        Literal["list", "test"],
        typer.Argument(
            help="list: what is done, and when; test: what would have been done."
        ),
    ],
    file: RobotFile,
    recording: Annotated[
        Path | None, typer.Option(help="For test: a file of `poise up --record`.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show the policies of a robot, those that Poise ships and its own, or test them.

    A test replays a recording of `poise up --record FILE`, and prints what the policies
    would have done when. Nothing is done.

    Examples
    --------
    poise policy list robot.yaml
    poise policy test robot.yaml --recording run.mcap
    """
    robot, console = load(file), console_to(stderr=as_json)
    if what == "list":
        policies = policies_of(robot.policies)
        show(policies, [_policy_table(policies)], as_json=as_json)
        return
    if recording is None:
        raise UsageError("give a recording: --recording FILE, of `poise up --record`")
    events = poise.test_policies(robot, recording, say=console.warn)
    show(events, _event_parts(events), as_json=as_json)


def _policy_table(policies: tuple[Policy, ...]) -> Table:
    rows = table("policy", "for each", "when", "lasts", "do", "cool down", folds=2)
    for policy in policies:
        rows.add_row(
            policy.name,
            policy.for_each or "",
            policy.when or policy.call or "",
            format_seconds(policy.lasts or 0.0),
            "off" if policy.off else policy.do or "",
            format_seconds(policy.cool_down or 0.0),
        )
    return rows


def _event_parts(events: tuple[poise.PolicyEvent, ...]) -> Iterator[RenderableType]:
    rows = table("at [s]", "policy", "do", "what was seen", folds=3)
    for event in events:
        rows.add_row(f"{event.at:.1f}", event.policy, event.do or "", event.what)
    yield rows
    if not events:
        yield "the policies would have done nothing"


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
    none = "no installed package has the entry point poise.architectures"
    show(rows, [_architecture_table(rows) if rows else none], as_json=as_json)


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
    described = Described(**structs.asdict(row), learned=tuple(beliefs))
    show(described, _architecture_parts(described), as_json=as_json)


def reset_command(name: Name, file: RobotFile) -> None:
    """Forget how often actions succeeded with an architecture.

    Examples
    --------
    poise repository reset laser_navigator robot.yaml
    """
    count = forget(load(file), name)
    console_to().print(f"{counted(count, 'outcome')} of '{name}' forgotten")


def _architecture_table(rows: list[Listed]) -> Table:
    shown = table("function", "architecture", "quality", "hash", "from", folds=4)
    for row in rows:
        source = f"{row.where} ({row.package})" if row.package else row.where
        unused = f"\nnot used: {row.unused}" if row.unused else ""
        quality = f"{row.quality:g}"
        where = escape(source + unused)
        shown.add_row(row.function, row.architecture, quality, row.hash, where)
    return shown


def _architecture_parts(row: Described) -> Iterator[RenderableType]:
    what = f"{row.architecture} provides {row.function}"
    for sentence in (
        f"{what}, quality {row.quality:g}, {row.layer} layer",
        f"from {row.where}" + (f", package {row.package}" if row.package else ""),
        f"hash {row.hash}",
        f"components: {', '.join(row.components)}",
        *((f"not used: {row.unused}",) if row.unused else ()),
    ):
        yield escape(sentence)
    if not row.learned:
        yield "nothing has been learned yet"
        return
    shown = table("action", "conditions", "success", "of", "hash", folds=1)
    for belief in row.learned:
        shown.add_row(
            belief.action,
            str(belief.conditions),
            f"{belief.mean:.0%} ± {belief.deviation:.0%}",
            f"{belief.done + belief.failed:.0f}",
            belief.hash if belief.is_present else f"{belief.hash}, before",
        )
    yield shown


repository_command = list_command
