"""Runs commands as users do."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

Poise = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def poise(tmp_path: Path) -> Poise:
    """Return what runs `poise` in the test's folder."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "poise", *arguments],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=110,
            check=False,
        )

    return run
