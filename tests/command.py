"""Runs `poise` as users do."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.busy import skip_as_busy
from tests.waiting import LONG

POISE = (sys.executable, "-m", "poise")
STARVED = "this machine was too busy to give the emulated computers"

Poise = Callable[..., subprocess.CompletedProcess[str]]


def run_poise(
    *words: object, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; return what it said and its exit code.

    Skip the test when it says that the host starved the emulated computers.
    """
    done = subprocess.run(
        [*POISE, *map(str, words)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    for line in done.stderr.splitlines():
        if done.returncode and STARVED in line:
            skip_as_busy(line)
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
            process.communicate(timeout=LONG)
