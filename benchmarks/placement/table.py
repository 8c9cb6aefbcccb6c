"""Tables that the placement benchmarks print."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table in Markdown; on stderr, as stdout is for JSON."""
    lines = [f"### {title}\n", _row(head), _row(["---" for _ in head])]
    sys.stderr.write("\n".join([*lines, *map(_row, rows)]) + "\n\n")


def _row(cells: Sequence[object]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def seconds(time: float) -> str:
    """Return a time for a table, in the unit that suits it."""
    if time < 1e-3:
        return f"{time * 1e6:.0f} us"
    return f"{time * 1e3:.1f} ms" if time < 1 else f"{time:.2f} s"
