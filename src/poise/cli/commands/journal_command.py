"""`poise journal`: what the manager saw, decided and did, and what came of it."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.markup import escape

from poise.cli.options import AsJson, print_json
from poise.errors import UsageError
from poise.manage.journal import KINDS, JournalEntry, read_journal
from poise.session.render.printable import console_to
from poise.session.state_folder import find_journal

_LOOK_EVERY = 0.2
_COLOURS = {"wrong": "red", "failed": "red", "right": "green", "decided": "bold"}


def journal_command(
    file: Annotated[
        Path | None,
        typer.Argument(help="Another journal than the last robot's, or `--robot`'s."),
    ] = None,
    robot: Annotated[
        str | None, typer.Option(help="The robot whose last journal is shown.")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option(help=f"Only these: {', '.join(KINDS)}.")
    ] = None,
    about: Annotated[
        str | None, typer.Option(help="Only entries that name this, such as 'vision'.")
    ] = None,
    last: Annotated[
        int | None, typer.Option(min=1, help="Only the last N entries.")
    ] = None,
    facts: Annotated[
        bool, typer.Option("--facts", help="With the facts of each: demands, costs.")
    ] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Wait for further entries until Ctrl-C.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show a manager's journal: what it saw, decided and did, and what came of it.

    Examples
    --------
    poise journal --kind decided --kind wrong --facts

    poise journal results/journal.jsonl --about vision --follow
    """
    if unknown := set(kind or ()) - set(KINDS):
        raise UsageError(f"--kind {unknown.pop()}: it is one of {', '.join(KINDS)}")
    if follow and as_json:
        raise UsageError("--follow and --json together: JSON is one whole object")

    def fits(entry: JournalEntry) -> bool:
        named = about is None or about in entry.what
        return named and (not kind or entry.kind in kind)

    if file is not None and robot is not None:
        raise UsageError("give a file or --robot, not both")
    if file is None:
        file = find_journal(robot)
        sys.stderr.write(f"journal of robot '{file.parent.name}': {file}\n")
    entries = read_journal(file)
    chosen = [entry for entry in entries if fits(entry)]
    chosen = chosen[-last:] if last else chosen
    if as_json:
        print_json({"entries": chosen})
        return
    console = console_to()
    _show(console, chosen, facts=facts)
    after = entries[-1].number if entries else 0
    while follow:
        time.sleep(_LOOK_EVERY)
        if new := read_journal(file, after):
            after = new[-1].number
            _show(console, [entry for entry in new if fits(entry)], facts=facts)


def _show(console: Console, entries: list[JournalEntry], *, facts: bool) -> None:
    for entry in entries:
        style = _COLOURS.get(entry.kind, "")
        console.print(escape(f"{entry.kind:8}{entry}"), style=style)
        if facts and entry.facts:
            text = msgspec.json.format(msgspec.json.encode(entry.facts), indent=2)
            console.print(escape(text.decode()), style="dim")
