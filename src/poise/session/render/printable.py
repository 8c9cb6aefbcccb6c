"""Records that print themselves: tables in a terminal, pictures too in a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.terminal_theme import TerminalTheme
from rich.text import Text

from poise.session.launch.printer import visible

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
        width = console_to().width
        console = SafeConsole(file=StringIO(), width=width, highlight=False)
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


class SafeConsole(Console):
    """Shows what would control the terminal in a text, as in a component's error."""

    def say(self, sentence: str) -> None:
        """Print a sentence, in which nothing is markup."""
        self.print(escape(sentence))

    def warn(self, sentence: str) -> None:
        """Print a sentence in yellow, in which nothing is markup."""
        self.print(escape(sentence), style="yellow")

    def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401, as the base
        """Return a text before its width is measured, as the base."""
        return super().render_str(visible(text), **options)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Render, as the base."""
        for segment in super().render(renderable, options):
            if segment.control is None:
                yield Segment(visible(segment.text), segment.style)
            else:
                yield segment


def console_to(*, stderr: bool = False) -> SafeConsole:
    """Return a console for a command; wide where no terminal says how wide it is."""
    console = SafeConsole(stderr=stderr, highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    return console
