"""Programs that take CPU: as other software would, and to keep CPUs at full clock."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator

_PERIOD = 0.02
"""It takes its share of each of these [s]."""


def background_load(cores: float) -> list[str]:
    """Return the command of a program that takes `cores` [at most 1]."""
    return [sys.executable, "-I", __file__, f"{cores:g}"]


def burn(cores: float) -> None:
    """Use `cores` [at most 1] of a host CPU, where that is to be had, for ever."""
    while True:
        end = time.monotonic() + _PERIOD
        used = time.process_time() + cores * _PERIOD
        while time.process_time() < used and time.monotonic() < end:
            pass
        time.sleep(max(0.0, end - time.monotonic()))


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
    """Keep each CPU busy with a program that gives way to all others (SCHED_IDLE).

    A CPU that has little to do is clocked down: its cores may do half of the work that
    they do on a busy machine. So what emulated computers can do would depend on what
    else runs.
    """
    with contextlib.ExitStack() as stack:
        for cpu in sorted(os.sched_getaffinity(0)):
            argv = [sys.executable, "-I", "-S", "-c", _SPIN, str(cpu), str(os.getpid())]
            process = stack.enter_context(
                subprocess.Popen(  # noqa: S603, Python
                    argv,
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,  # Ctrl-C is for the command
                )
            )
            stack.callback(process.kill)
        yield


if __name__ == "__main__":
    burn(float(sys.argv[1]))
