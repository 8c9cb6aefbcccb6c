"""Poise: two components in C++, in one container."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

from benchmarks.calls.cpp import direct, echo
from benchmarks.calls.timing import Trips


def connect(folder: Path) -> AbstractContextManager[Trips]:
    """Give the round trips."""
    return direct(folder, echo.Caller, echo.Callee)
