"""Keeps the CPUs of this machine at their full clock, so that measurements agree.

A CPU that has little to do is clocked down: its cores may do half of the work that they
do on a busy machine. So what emulated computers can do would depend on what else runs.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator

_SPIN = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
while os.getppid() == int(sys.argv[2]):
    for _ in range(1_000_000):
        pass
"""


@contextlib.contextmanager
def full_speed() -> Iterator[None]:
    """Keep each CPU busy with a program that gives way to all others (SCHED_IDLE)."""
    with contextlib.ExitStack() as stack:
        for cpu in sorted(os.sched_getaffinity(0)):
            argv = [sys.executable, "-I", "-S", "-c", _SPIN, str(cpu), str(os.getpid())]
            process = stack.enter_context(
                subprocess.Popen(argv, stdin=subprocess.DEVNULL)  # noqa: S603, Python
            )
            stack.callback(process.kill)
        yield
