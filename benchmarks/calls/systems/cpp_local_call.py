"""Poise: components in C++ in two containers over the connector kind ``local``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.calls import container
from benchmarks.calls.cpp import echo
from benchmarks.calls.cpp import local as connect

__all__ = ["connect", "serve"]


def serve(folder: Path, ready: Callable[[], None]) -> None:
    """Send back what comes."""
    container.serve("local", folder, ready, echo.Callee)
