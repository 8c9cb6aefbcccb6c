"""A recording as a table in CSV, for spreadsheets and data frames."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from typing import TextIO

from poise.wire.samples import AgentSample

COLUMNS = (
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
)


def write_csv(samples: Iterable[AgentSample], out: TextIO) -> None:
    """Write a row for every component in every sample; counters are totals."""
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(COLUMNS)
    for sample in samples:
        for container in sample.containers:
            for each in container.components:
                rows.writerow(
                    (
                        sample.computer,
                        container.name,
                        each.name,
                        each.epoch,
                        container.at,
                        each.cpu,
                        each.wait,
                        each.asked,
                        each.done,
                        container.cpu,
                        container.memory,
                    )
                )
