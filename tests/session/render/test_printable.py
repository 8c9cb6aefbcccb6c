"""What components say controls no terminal."""

from __future__ import annotations

import pytest
from rich.markup import escape
from rich.table import Table

from poise.session.launch.printer import visible
from poise.session.render.printable import console_to

TEXT = "too \x1b[2Jwide\x9b2J"


def test_of_the_text_of_others_a_terminal_gets_no_control(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Else an error could clear the screen of whoever asks for the status."""
    console, table = console_to(), Table()
    table.add_row(TEXT)
    console.print(escape(TEXT))
    console.print(table)
    said = capsys.readouterr().out
    assert said.count(r"too \x1b[2Jwide\x9b2J") == 2
    assert "\x1b" not in said


def test_only_colours_may_pass() -> None:
    text = "\x1b[1;31mred\x1b[0m\tand\n\x1b[2J\r"
    assert visible(text) == "\\x1b[1;31mred\\x1b[0m\tand\n\\x1b[2J\\r"
    assert visible(text, colours=True) == "\x1b[1;31mred\x1b[0m\tand\n\\x1b[2J\\r"
