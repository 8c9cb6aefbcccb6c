"""Poise: calls between containers over the connector kind ``remote``."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from benchmarks.calls import container
from benchmarks.calls.timing import Trips


def serve(folder: Path, ready: Callable[[], None]) -> None:
    """Send back what comes."""
    container.serve("remote", folder, ready)


def connect(folder: Path) -> AbstractContextManager[Trips]:
    """Give the round trips."""
    return container.calls("remote", folder)
