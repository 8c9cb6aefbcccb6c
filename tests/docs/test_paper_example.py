"""The page of `examples/paper` shows what its commands print."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from poise.cli.command_table import build

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "examples/paper/README.md").read_text()
SHOWN = re.findall(r"```sh\npoise (.*?)\n```.*?```\n(.*?)```", PAGE, re.DOTALL)


def words(text: str) -> str:
    """Return a text without its layout, and without how long a decision took."""
    return " ".join(re.sub(r"in [\d.]+ \ws|─+", "", text).split())


@pytest.mark.parametrize(("line", "shown"), SHOWN)
def test_the_page_shows_what_the_command_prints(
    line: str, shown: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    arguments = shlex.split(line)
    done = CliRunner().invoke(build(arguments), arguments)
    assert words(shown) in words(done.output)
    assert done.exit_code == (1 if shown.startswith("no placement") else 0)


def test_the_page_has_the_three_commands_of_the_paper() -> None:
    assert [shlex.split(line)[-1] for line, _ in SHOWN] == [
        "one_piece",
        "three_pieces",
        "C3",
    ]
