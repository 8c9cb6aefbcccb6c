"""The wheels of this commit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LIMIT = 1800.0
"""Compiling everything four times takes minutes [s]."""


@pytest.fixture(scope="module")
def dist() -> Path:
    """Return the folder of the wheels, built if they are not."""
    script = [sys.executable, str(ROOT / ".ci/wheels.py")]
    for words, fail in ((["tools"], pytest.skip), ([], pytest.fail)):
        done = subprocess.run(
            [*script, *words],
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        if done.returncode:
            fail(f"{' '.join(done.args)}: {done.stdout}{done.stderr}")
    return ROOT / "dist"
