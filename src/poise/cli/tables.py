"""How tables look: narrow, so that they fit 80 columns, and never cut a name off."""

from __future__ import annotations

from rich import box
from rich.table import Table


def table(*columns: str) -> Table:
    """Return an empty table; long words are broken over lines rather than cut."""
    made = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for title in columns:
        made.add_column(title, overflow="fold")
    return made
