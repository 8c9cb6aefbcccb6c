"""Some defects that the simulator has to find; `mutations.py` has all."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("name", ["page", "long-lease", "no-revoke", "no-buffer"])
def test_a_defect_is_found_within_a_few_seeds(name: str) -> None:
    """It is brought back in another process, which no other test has to fear."""
    words = "-m", "tests.simulation.mutations", name, "--here", "--seeds", "10"
    done = subprocess.run(
        [sys.executable, *words, "--shrink", "0"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
