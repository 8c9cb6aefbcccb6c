"""A recording as tables: CSV for spreadsheets, Parquet for data frames."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, NamedTuple

from poise.errors import UsageError
from poise.wire.records.samples import (
    AgentSample,
    ComponentSample,
    ConnectorSample,
    ContainerSample,
)

Which = Literal["components", "connectors"]
Value = str | int | float

COLUMNS: dict[Which, dict[str, str]] = {
    "components": {
        "computer": "agent.computer",
        "container": "container.name",
        "component": "entry.name",
        "epoch": "entry.epoch",
        "at_s": "container.at",
        "cpu_s": "entry.cpu",
        "wait_s": "entry.wait",
        "asked": "entry.asked",
        "done": "entry.done",
        "container_cpu_s": "container.cpu",
        "container_memory_bytes": "container.memory",
    },
    "connectors": {
        "computer": "agent.computer",
        "container": "container.name",
        "connector": "entry.name",
        "at_s": "container.at",
        "calls": "entry.calls",
        "messages": "entry.messages",
        "bytes_out": "entry.bytes_out",
        "bytes_in": "entry.bytes_in",
        "errors": "entry.errors",
        "drops": "entry.drops",
        "arrivals": "entry.arrivals",
        "latency_s": "entry.latency",
        "latency_error_s": "entry.latency_error",
    },
}
"""Of each table: column -> where its value is in a sample; counters are totals since
the component or connector began."""
_MANY = 10_000
"""Rows that are turned into columns at a time."""


class _Row(NamedTuple):
    agent: AgentSample
    container: ContainerSample
    entry: ComponentSample | ConnectorSample


def rows(samples: Iterable[AgentSample], which: Which) -> Iterator[dict[str, Value]]:
    """Yield a row for every component, or end of a connector, in every sample."""
    columns = COLUMNS[which]
    values = attrgetter(*columns.values())
    for sample in samples:
        for container in sample.containers:
            for entry in getattr(container, which):
                row = _Row(sample, container, entry)
                yield dict(zip(columns, values(row), strict=True))


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
    found: Iterable[dict[str, Value]], path: Path, columns: Iterable[str]
) -> int:
    count = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, list(columns), lineterminator="\n")
        out.writeheader()
        for count, row in enumerate(found, 1):  # noqa: B007, the last is returned
            out.writerow(row)
    return count


def _write_parquet(
    found: Iterator[dict[str, Value]], path: Path, columns: Iterable[str]
) -> int:
    try:
        import pyarrow as pa  # noqa: PLC0415, an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(
            f"{path}: Parquet needs pyarrow: pip install 'poise[parquet]'"
        ) from error
    schema = pa.schema([(name, _type(pa, name)) for name in columns])
    count = 0
    with parquet.ParquetWriter(path, schema) as writer:
        while group := list(itertools.islice(found, _MANY)):
            writer.write_table(pa.Table.from_pylist(group, schema=schema))
            count += len(group)
    return count


def _type(pa: Any, column: str) -> Any:  # noqa: ANN401, of a library without types
    if column in ("computer", "container", "component", "connector"):
        return pa.string()
    return pa.float64() if column.endswith("_s") else pa.int64()
