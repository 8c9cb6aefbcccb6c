"""A computer of a running robot loses power."""

from __future__ import annotations

import time

from msgspec import Struct

from examples.demo.waiting import (
    WARM_UP,
    Check,
    Say,
    active_components,
    wait,
    wait_until,
)
from poise import Robot, Running, emulated, place, up


class LostComputerScene(Struct, frozen=True, kw_only=True):
    """A computer loses power.

    Parameters
    ----------
    ok
        Whether each component is active once after the computer is back.
    detected_s
        Until the manager said so [s].
    active_s
        Until all its components were active on the other one [s].
    """

    scene: str = "lost-computer"
    ok: bool
    detected_s: float
    active_s: float


def lose_computer(robot: Robot, say: Say, check: Check) -> LostComputerScene:
    """Crash the computer on which all components run; RunError if none restarts."""
    placed = place(robot, method="static")
    lost = next(iter(placed.where.values()))
    with (
        emulated(robot, say=say) as computers,
        up(robot, placement=placed, say=say, check=check) as running,
    ):
        wait(WARM_UP, check)
        say(f"'{lost}' loses power")
        began = time.monotonic()
        computers.crash(lost)
        detected = wait_until(
            lambda: lost in running.status().out_of_reach, began, check
        )
        active = wait_until(lambda: _all_active(running, lost), began, check)
        say("the power is back")
        computers.boot(lost)
        wait_until(lambda: not running.status().deviations, time.monotonic(), check)
        once = sorted(active_components(running)) == sorted(running.status().placement)
    return LostComputerScene(ok=once, detected_s=detected, active_s=active)


def _all_active(running: Running, lost: str) -> bool:
    placement = running.status().placement
    is_elsewhere = lost not in placement.values()
    return is_elsewhere and set(active_components(running, lost)) >= placement.keys()
