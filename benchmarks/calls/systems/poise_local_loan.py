"""Poise: calls with loans over the connector kind ``local``."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from benchmarks.calls import container
from benchmarks.calls.timing import Trips


def serve(folder: Path, ready: Callable[[], None]) -> None:
    """Answer with loans."""
    container.serve("local", folder, ready)


def connect(folder: Path) -> AbstractContextManager[Trips]:
    """Give the round trips."""
    return container.loans(folder)
