"""Poise: two components in one container, called as components call."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from benchmarks.calls.container import connect as connect_containers
from benchmarks.calls.systems.bare import Caller
from benchmarks.calls.timing import Trips


@contextmanager
def connect(folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    with connect_containers("direct", folder) as runner:
        yield Caller(cast("Any", runner.component).calls).trips
