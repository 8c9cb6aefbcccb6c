"""How far computers' clocks are apart, for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rich.table import Table

from poise.session.render.shared_tables.columns import table
from poise.units import format_seconds
from poise.wire.records.clocks import ClockStatus


def clock_tables(
    clocks: Mapping[str, Mapping[str, ClockStatus]],
) -> Iterator[Table]:
    """Yield a row for each two computers: how far the second is ahead, +- error."""
    rows = table("clock of", "seen from", "ahead by", "quickest round trip", folds=1)
    for here, known in clocks.items():
        for there, clock in known.items():
            if there < here and here in clocks.get(there, {}):
                continue  # the same from the other side
            error = format_seconds(clock.error)
            ahead = f"{_signed(clock.offset, clock.error)} ± {error}"
            rows.add_row(there, here, ahead, format_seconds(clock.trip))
    if rows.row_count:
        yield rows


def _signed(offset: float, error: float) -> str:
    """Return an offset, as exactly as it is known."""
    if abs(offset) <= error:
        return "0 s"
    sign = "-" if offset < 0 else ""
    return f"{sign}{format_seconds(abs(offset))}"
