"""Runs a case in processes of its own, pinned the same way for every system."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

import msgspec
from msgspec import Struct

from benchmarks.calls.cases import Case
from benchmarks.calls.peer import Work
from benchmarks.calls.timing import Times

LIMIT = 60.0
"""A process that says nothing for this time has failed [s]."""
IDLE = 0.5
"""How long the CPU of idle processes is watched [s]."""


class Row(Struct, frozen=True):
    """What was measured; `idle` is the CPU of both idle processes [cores]."""

    title: str
    key: str
    times: tuple[Times, ...] = ()
    idle: float = 0.0
    remark: str = ""


def run(case: Case, counts: dict[int, int]) -> Row:
    """Measure a case; a system that is not installed gives a row that says so."""
    try:
        import_module(f"benchmarks.calls.systems.{case.module}")
    except ImportError as error:
        return Row(case.title, case.key, remark=f"not installed: {error.name}")
    cpus = sorted(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder:
        wanted = {size: counts[size] for size in case.sizes}
        serve = Work("serve", case.module, folder, cpus[0], {})
        connect = Work("connect", case.module, folder, cpus[-1], wanted)
        if case.alone:
            with _process(connect) as client:
                return _row(case, [client])
        with _process(serve) as server:
            _answer(server)
            with _process(connect) as client:
                return _row(case, [client, server])


@contextmanager
def _process(work: Work) -> Iterator[subprocess.Popen[bytes]]:
    argv = [sys.executable, "-m", "benchmarks.calls.peer"]
    process = subprocess.Popen(
        [*argv, msgspec.json.encode(work).decode()],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def _answer(process: subprocess.Popen[bytes]) -> tuple[Times, ...]:
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], LIMIT)
    line = process.stdout.readline() if ready else b""
    if not line:
        raise RuntimeError(f"no answer from {process.args!r}")
    return msgspec.json.decode(line, type=tuple[Times, ...])


def _row(case: Case, processes: list[subprocess.Popen[bytes]]) -> Row:
    times = _answer(processes[0])
    time.sleep(IDLE)  # what the last call left to do is not idle
    began, before = time.monotonic(), sum(map(_cpu, processes))
    time.sleep(IDLE)
    used = sum(map(_cpu, processes)) - before
    idle = used / (time.monotonic() - began)
    return Row(case.title, case.key, times, round(idle, 4))


def _cpu(process: subprocess.Popen[bytes]) -> float:
    """Return the CPU time [s] of a process, by Linux's clock of it."""
    return time.clock_gettime((~process.pid << 3) | 2)
