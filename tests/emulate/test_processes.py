"""Ending processes in stages."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys

import pytest

from poise.emulate import processes
from poise.emulate.processes import MARK, freeze, marked, stop
from poise.errors import RunError
from poise.kernel_counters import process_stat

pytestmark = pytest.mark.slow

STUBBORN = (
    "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
    "print('ready', flush=True); signal.pause()"
)


def running(*children: subprocess.Popen[bytes]) -> list[int]:
    return [child.pid for child in children if child.poll() is None]


def test_willing_process_is_only_asked() -> None:
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as cat:
        stop(lambda: running(cat), ask=10.0)
        assert cat.returncode == -signal.SIGTERM


def test_stubborn_process_is_killed() -> None:
    argv = [sys.executable, "-c", STUBBORN]
    with subprocess.Popen(argv, stdout=subprocess.PIPE) as child:
        assert child.stdout
        assert child.stdout.readline() == b"ready\n"
        stop(lambda: running(child), ask=0.05)
        assert child.returncode == -signal.SIGKILL


def test_no_processes_are_no_trouble() -> None:
    stop(list)


def test_what_cannot_be_frozen_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "KILL", 0.1)
    others = itertools.count(1 << 23)  # no process has such a number
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as cat:
        with pytest.raises(RunError, match="still start others"):
            freeze(lambda: [cat.pid, next(others)])
        stat = process_stat(cat.pid)
        assert stat is not None
        assert stat.state != "T"


@pytest.mark.parametrize("mark", ["poise-test-a", "poise-test-b"])
def test_marked_processes_are_those_that_inherited_the_mark(mark: str) -> None:
    env = {**os.environ, MARK: mark}
    argv = ["sh", "-c", "echo ready; cat; true"]
    with subprocess.Popen(
        argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env
    ) as shell:
        assert shell.stdin
        assert shell.stdout
        assert shell.stdout.readline() == b"ready\n"
        assert shell.pid in marked(mark)
        assert not marked(mark[:-1])
        shell.stdin.close()
