"""Finds the processes of a command, also those that left its session and parent."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

from poise.runtime.hosting.descendants import children

NAME = "POISE_COMPONENT"
"""The variable that tells a command, and what it starts, which component it is."""
GONE_LIMIT = 0.5
"""What was killed is waited for so long [s]."""
_LOOK = 0.01


def signal_all(component: str, group: int, number: signal.Signals) -> None:
    """Send a signal to a process group, and to the command's other processes."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, number)
    for process in _processes_of(component):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if os.getpgid(process) != group:
                os.kill(process, number)


def end_all(component: str, group: int) -> None:
    """Kill all processes of a command, and wait until they are gone."""
    deadline = time.monotonic() + GONE_LIMIT
    signal_all(component, group, signal.SIGKILL)
    while _processes_of(component) and time.monotonic() < deadline:
        time.sleep(_LOOK)
        signal_all(component, group, signal.SIGKILL)


def _processes_of(component: str) -> list[int]:
    """Return this process's descendants with the component's name that still run."""
    found, parents = list[int](), [os.getpid()]
    while parents:
        for child in children(parents.pop()):
            parents.append(child)
            with contextlib.suppress(OSError):  # it has ended, or gained rights
                environment = Path(f"/proc/{child}/environ").read_bytes()
                if f"{NAME}={component}".encode() in environment.split(b"\0"):
                    found.append(child)
    return found
