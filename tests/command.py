"""Runs `poise` as users do."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

POISE = (sys.executable, "-m", "poise")
LIMIT = 200.0
"""Far longer than any command of a test takes [s]; pytest gives up a little later."""

Poise = Callable[..., subprocess.CompletedProcess[str]]


def run_poise(
    *words: object, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; return what it said and its exit code."""
    return subprocess.run(
        [*POISE, *map(str, words)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
