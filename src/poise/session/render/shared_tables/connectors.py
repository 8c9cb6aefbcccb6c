"""What connectors counted, as tables: one row for each direction under each name."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from poise.session.render.shared_tables.columns import NamedRows
from poise.units import format_bytes, format_seconds
from poise.wire.records.status import ConnectorStatus, Summary

_OF = "connector"
_Ends = list[ConnectorStatus]
_Cells = Callable[[_Ends], tuple[str, ...]]


def connector_tables(ends: Iterable[ConnectorStatus]) -> list[NamedRows]:
    """Return what went over connectors, how long it took, and how large it was.

    While a component moves, its connectors have a target more: their numbers are added.
    """
    grouped = dict(sorted(_grouped(ends).items()))
    counts = NamedRows(_OF, "kind", "end", "count", "out", "in", "errors", "drops")
    times = NamedRows(_OF, "end", "took", "p99", "one way", "p99")
    sizes = NamedRows(_OF, "end", "size", "p99", "largest")
    for rows, cells in ((counts, _counts), (times, _times), (sizes, _sizes)):
        _fill(rows, grouped, cells)
    return [rows for rows in (counts, times, sizes) if rows.row_count]


def _grouped(ends: Iterable[ConnectorStatus]) -> dict[tuple[str, str], _Ends]:
    found: dict[tuple[str, str], _Ends] = {}
    for end in ends:
        found.setdefault((end.name, end.end), []).append(end)
    return found


def _fill(
    rows: NamedRows, grouped: dict[tuple[str, str], _Ends], cells: _Cells
) -> None:
    for (name, _), same in grouped.items():
        # a source that has a path more reports the same numbers twice
        found = cells(same if same[0].end == "target" else same[:1])
        if found:
            rows.add_row(name, *found)


def _counts(same: _Ends) -> tuple[str, ...]:
    kind = same[0].kind if all(end.ready for end in same) else "not joined"
    sizes = [sum(e.bytes_out for e in same), sum(e.bytes_in for e in same)]
    return (
        kind,
        same[0].end,
        str(sum(e.calls + e.messages for e in same) or ""),
        *(format_bytes(size) if size else "" for size in sizes),
        str(sum(e.errors for e in same) or ""),
        str(sum(e.drops for e in same) or ""),
    )


def _times(same: _Ends) -> tuple[str, ...]:
    """Return how long calls took, or messages waited, whichever there are more of."""
    took = _most(s for e in same for s in (e.delay, e.wait))
    busiest = max(same, key=lambda end: end.latency.count)
    way, error = busiest.latency, busiest.latency_error
    if not took.count and not way.count:
        return ()
    median, p99 = _pair(way)
    if error:
        median += f" ± {format_seconds(error)}"
    return (same[0].end, *_pair(took), median, p99)


def _sizes(same: _Ends) -> tuple[str, ...]:
    size = _most(end.size for end in same)
    if not size.count:
        return ()
    found = size.median, size.p99, size.maximum
    return (same[0].end, *map(format_bytes, found))


def _pair(times: Summary) -> tuple[str, str]:
    if not times.count:
        return "", ""
    return format_seconds(times.median), format_seconds(times.p99)


def _most(summaries: Iterable[Summary]) -> Summary:
    return max(summaries, key=lambda summary: summary.count)
