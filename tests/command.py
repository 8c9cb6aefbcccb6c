"""Runs `poise` as users do."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

POISE = (sys.executable, "-m", "poise")
LIMIT = 200.0
"""Far longer than any command of a test takes [s]; pytest gives up a little later."""

_BUSY = ("run it again when less else runs", "did not answer within")
_TRIES = 3

Poise = Callable[..., subprocess.CompletedProcess[str]]


def run_poise(
    *words: object, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; return what it said and its exit code.

    It runs anew when it says that the machine was too busy.
    """
    for _ in range(_TRIES):
        done = subprocess.run(
            [*POISE, *map(str, words)],
            cwd=cwd,
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        if not any(each in done.stdout + done.stderr for each in _BUSY):
            break
    return done


@contextlib.contextmanager
def robot_up(file: Path, *options: object) -> Iterator[subprocess.Popen[str]]:
    """Start a robot; end it afterwards, whether or not somebody did."""
    argv = [*POISE, "up", str(file), *map(str, options)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert any("is up" in line for line in process.stdout)
            yield process
        finally:
            process.terminate()
            process.communicate(timeout=LIMIT)
