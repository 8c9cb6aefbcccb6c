"""Records that print themselves: tables in a terminal, pictures too in a notebook."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from io import StringIO

from rich.console import Console, RenderableType
from rich.terminal_theme import TerminalTheme

_WIDTH = 400
"""Of what is not a terminal [characters]: nothing is broken over lines there."""


class Printable:
    """Prints what `parts` returns."""

    __slots__ = ()

    def parts(self) -> Sequence[RenderableType]:
        """Return what is printed, from top to bottom."""
        raise NotImplementedError

    def picture(self) -> str:
        """Return what a notebook shows above the parts, as HTML."""
        return ""

    def __rich_console__(self, *_: object) -> Iterator[RenderableType]:
        """Give the parts, for rich."""
        yield from self.parts()

    def __str__(self) -> str:
        """Return the parts as text."""
        console = Console(file=StringIO(), width=console_to().width, highlight=False)
        with console.capture() as text:
            console.print(self)
        return text.get().rstrip()

    def _repr_html_(self) -> str:
        """Return picture and parts as HTML, for Jupyter."""
        return self.picture() + self.html()

    def html(self) -> str:
        """Return the parts as HTML."""
        console = Console(file=StringIO(), width=_WIDTH, record=True, highlight=False)
        console.print(self)
        return console.export_html(
            theme=_COLOURS, code_format=_HTML, inline_styles=True
        )


_GREY, _BLUE, _PURPLE = (127, 127, 127), (46, 117, 207), (163, 94, 163)
_COLOURS = TerminalTheme(
    (255, 255, 255),
    (0, 0, 0),
    [
        _GREY,
        (219, 70, 48),
        (30, 138, 90),
        (128, 128, 0),
        _BLUE,
        _PURPLE,
        (20, 133, 133),
        _GREY,
    ],
)
"""Can be read on a light page, and on a dark one."""
_HTML = '<pre style="line-height:normal">{code}</pre>'


def console_to(*, stderr: bool = False) -> Console:
    """Return a console for a command; wide where no terminal says how wide it is."""
    console = Console(stderr=stderr, highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    return console
