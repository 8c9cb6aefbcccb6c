"""What connectors counted, as a table: one row for each direction."""

from __future__ import annotations

from collections.abc import Iterable

from rich.table import Table

from poise.cli.tables import table
from poise.units import format_bytes, format_seconds
from poise.wire.messages import ConnectorStatus, Summary


def connector_table(ends: Iterable[ConnectorStatus]) -> Table:
    """Return what went over connectors: calls or messages, bytes, and how long it took.

    While a component moves, its connectors have a target more: their numbers are added.
    """
    rows = table(
        *("connector", "kind", "end", "count", "out", "in"),
        *("errors", "drops", "median", "p99"),
    )
    before = ""
    for (name, _), same in sorted(_grouped(ends).items()):
        kind = same[0].kind
        is_joined = all(end.ready for end in same)
        head = (name, kind if is_joined else f"{kind}, not joined")
        rows.add_row(*(head if name != before else ("", "")), *_cells(same))
        before = name
    return rows


def _grouped(
    ends: Iterable[ConnectorStatus],
) -> dict[tuple[str, str], list[ConnectorStatus]]:
    found: dict[tuple[str, str], list[ConnectorStatus]] = {}
    for end in ends:
        found.setdefault((end.name, end.end), []).append(end)
    return found


def _cells(same: list[ConnectorStatus]) -> tuple[str, ...]:
    if same[0].end != "target":  # it has a path more, and the same numbers
        same = same[:1]
    sizes = [sum(e.bytes_out for e in same), sum(e.bytes_in for e in same)]
    times = max((_times(e) for e in same), key=lambda summary: summary.count)
    return (
        same[0].end,
        str(sum(e.calls + e.messages for e in same) or ""),
        *(format_bytes(size) if size else "" for size in sizes),
        str(sum(e.errors for e in same) or ""),
        str(sum(e.drops for e in same) or ""),
        format_seconds(times.median) if times.count else "",
        format_seconds(times.p99) if times.count else "",
    )


def _times(end: ConnectorStatus) -> Summary:
    """Return how long calls took, or messages waited, whichever there are more of."""
    return max(end.delay, end.wait, key=lambda summary: summary.count)
