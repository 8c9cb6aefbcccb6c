"""How tables look: narrow, so that they fit 80 columns, and never cut a name off."""

from __future__ import annotations

from rich import box
from rich.table import Table


def table(*columns: str, folds: int = 0) -> Table:
    """Return an empty table; long words are broken over lines rather than cut.

    The column with the number `folds` gives way to the others.
    """
    made = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for place, title in enumerate(columns):
        made.add_column(title, overflow="fold", no_wrap=place != folds)
    return made
