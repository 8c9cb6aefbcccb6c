"""What the scenes have in common: waiting, and what is active."""

from __future__ import annotations

import time
from collections.abc import Callable

from poise import RunError, Running

Say = Callable[[str], object]
"""Takes a sentence."""
Check = Callable[[], object]
"""Called several times a second while a scene waits; may raise to end that."""

WARM_UP = 4.0
LOOK_EVERY = 0.1
_LIMIT = 30.0
"""A scene fails when the robot has not adapted within this time [s]."""


def active_components(running: Running, lost: str = "") -> list[str]:
    """Return the active components of all computers but a lost one."""
    return [
        component.name
        for computer, component in running.status().located()
        if computer != lost and component.state == "active"
    ]


def wait_until(holds: Callable[[], bool], began: float, check: Check) -> float:
    """Return how long after `began` something held [s]; RunError when it never did."""
    while not holds():
        wait(LOOK_EVERY / 5, check)
        if time.monotonic() - began > _LIMIT:
            raise RunError(f"the robot did not adapt within {_LIMIT:g} s")
    return time.monotonic() - began


def wait(seconds: float, check: Check) -> None:
    """Wait, and call `check` meanwhile."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        check()
        time.sleep(min(left, LOOK_EVERY))


def measures(running: Running) -> dict[str, int]:
    """Return the largest value of each measure of all components."""
    return {
        name: int(summary.maximum)
        for _, component in running.status().located()
        for name, summary in component.measures.items()
    }
