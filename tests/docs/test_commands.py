"""Every command line of the documents is one that `poise` understands."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
import typer
from typer.testing import CliRunner

from poise.cli.command_table import COMMANDS, build

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "examples").rglob("*.md")),
]


def written(text: str) -> Iterator[str]:
    """Yield the command lines in blocks for a shell, and in table cells."""
    fences = re.findall(r"^```(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    for block in (block for kind, block in fences if kind in {"", "sh", "console"}):
        for line in block.splitlines():
            found = re.match(
                r"(?:\$ |\.venv/bin/)?(poise [a-z].*?)\s*(?:[&>|#].*)?$", line
            )
            if found:
                yield found[1]
    yield from re.findall(r"^\| `(poise [^`]+)`", text, re.MULTILINE)


LINES = sorted(
    {line for document in DOCUMENTS for line in written(document.read_text())}
)


def test_the_documents_show_every_command() -> None:
    pairs = [line.split()[1:3] for line in LINES]
    shown = {" ".join(pair) for pair in pairs} | {first for first, *_ in pairs}
    assert COMMANDS.keys() <= shown
    assert {first for first, *_ in pairs} <= {name.split()[0] for name in COMMANDS}


@pytest.mark.parametrize("line", LINES)
def test_the_command_line_is_understood(line: str) -> None:
    _, *words = shlex.split(line)
    group = typer.main.get_command(build(words))
    assert isinstance(group, typer.core.TyperGroup)
    command, words = group.commands[words[0]], words[1:]
    if isinstance(command, typer.core.TyperGroup):
        command, words = command.commands[words[0]], words[1:]
    try:
        # parses all words, checks their types, and runs nothing
        command.make_context("poise", words)
    except click.ClickException as error:
        pytest.fail(f"{line}: {error.format_message()}")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(name: str) -> None:
    words = name.split()
    told = CliRunner().invoke(build(words), [*words, "--help"])
    assert told.exit_code == 0
    assert f"poise {name} " in told.output.partition("Example")[2]
