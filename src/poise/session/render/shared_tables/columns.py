"""How tables look: narrow, so that they fit 80 columns, and never cut a name off."""

from __future__ import annotations

from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.table import Table


def table(*columns: str, folds: int = 0) -> Table:
    """Return an empty table; long words are broken over lines rather than cut.

    The first column, of names, and the one with the number `folds` give way to others.
    """
    made = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for place, title in enumerate(columns):
        made.add_column(title, overflow="fold", no_wrap=place not in {0, folds})
    return made


class NamedRows:
    """A table of rows that stand under a name, which has a line of its own.

    Names of connectors are as long as four names of components and ports: in a column
    they would leave no room for the numbers.

    Parameters
    ----------
    title
        Of the names.
    """

    def __init__(self, title: str, *columns: str) -> None:
        self._rows = table(title, *columns)
        self._names: list[str] = []

    @property
    def row_count(self) -> int:
        """How many rows there are, names aside."""
        return len(self._names)

    def add_row(self, name: str, *cells: str) -> None:
        """Add a row; that of the same name as the one before stands under it."""
        self._names.append(name)
        self._rows.add_row("", *cells)

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        """Give the lines, for rich."""
        title, rule, *rows = console.render_lines(self._rows, options, pad=False)
        yield from _line(title)
        yield from _line(rule)
        before = None
        for name, row in zip(self._names, rows, strict=True):
            if name != before:
                yield name
            before = name
            yield from _line(row)


def _line(segments: list[Segment]) -> list[Segment]:
    return [*segments, Segment.line()]
