"""A recording as tables: CSV for spreadsheets, Parquet for data frames."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

from poise.errors import UsageError
from poise.wire.records.samples import AgentSample

Which = Literal["components", "connectors"]
Value = str | int | float

COLUMNS: dict[Which, tuple[str, ...]] = {
    "components": (
        "computer",
        "container",
        "component",
        "epoch",
        "at_s",
        "cpu_s",
        "wait_s",
        "asked",
        "done",
        "container_cpu_s",
        "container_memory_bytes",
    ),
    "connectors": (
        "computer",
        "container",
        "connector",
        "at_s",
        "calls",
        "messages",
        "bytes_out",
        "bytes_in",
        "errors",
        "drops",
        "arrivals",
        "latency_s",
        "latency_error_s",
    ),
}
"""Of each table; counters are totals since the component or connector began."""
_MANY = 10_000
"""Rows that are turned into columns at a time."""


def rows(samples: Iterable[AgentSample], which: Which) -> Iterator[tuple[Value, ...]]:
    """Yield a row for every component, or end of a connector, in every sample."""
    for sample in samples:
        for container in sample.containers:
            head, at = (sample.computer, container.name), container.at
            if which == "connectors":
                for end in container.connectors:
                    yield (
                        *head,
                        end.name,
                        at,
                        end.calls,
                        end.messages,
                        end.bytes_out,
                        end.bytes_in,
                        end.errors,
                        end.drops,
                        end.arrivals,
                        end.latency,
                        end.latency_error,
                    )
                continue
            for each in container.components:
                yield (
                    *head,
                    each.name,
                    each.epoch,
                    at,
                    each.cpu,
                    each.wait,
                    each.asked,
                    each.done,
                    container.cpu,
                    container.memory,
                )


def export(samples: Iterable[AgentSample], path: Path, which: Which) -> int:
    """Write a table to a file whose name ends in .csv or .parquet; return its rows.

    Raises
    ------
    UsageError
        It ends otherwise, or Parquet needs a package that is not installed.
    """
    writers = {".csv": _write_csv, ".parquet": _write_parquet}
    if path.suffix not in writers:
        raise UsageError(
            f"{path}: the name says the format, and ends in {' or '.join(writers)}"
        )
    return writers[path.suffix](rows(samples, which), path, COLUMNS[which])


def _write_csv(
    found: Iterable[tuple[Value, ...]], path: Path, columns: tuple[str, ...]
) -> int:
    count = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(columns)
        for row in found:
            out.writerow(row)
            count += 1
    return count


def _write_parquet(
    found: Iterable[tuple[Value, ...]], path: Path, columns: tuple[str, ...]
) -> int:
    try:
        import pyarrow as pa  # noqa: PLC0415, an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(
            f"{path}: Parquet needs pyarrow: pip install 'poise[parquet]'"
        ) from error
    schema = pa.schema([(name, _type(pa, name)) for name in columns])
    count, waiting = 0, list[tuple[Value, ...]]()
    with parquet.ParquetWriter(path, schema) as writer:

        def flush() -> None:
            if waiting:
                values = dict(zip(columns, zip(*waiting, strict=True), strict=True))
                writer.write_table(pa.table(values, schema=schema))
            waiting.clear()

        for row in found:
            waiting.append(row)
            count += 1
            if len(waiting) == _MANY:
                flush()
        flush()
    return count


def _type(pa: Any, column: str) -> Any:  # noqa: ANN401, of a library without types
    if column in ("computer", "container", "component", "connector"):
        return pa.string()
    return pa.float64() if column.endswith("_s") else pa.int64()
