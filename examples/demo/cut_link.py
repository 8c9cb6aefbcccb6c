"""A computer of a running robot is cut off, and its link is healed again."""

from __future__ import annotations

import time
from collections import Counter

from msgspec import Struct

from examples.demo.waiting import WARM_UP, Check, Say, measures, wait, wait_until
from poise import Robot, Running, emulated, place, up

_MOVED, _CUT = "passer", "right"
_CUT_FOR = 5.0
"""The link is cut for so long [s]; the manager counts its agent as gone after 2 s."""


class CutLinkScene(Struct, frozen=True, kw_only=True):
    """A computer is cut off from all others and from the manager.

    Parameters
    ----------
    ok
        Whether all is active once after the link was healed, and nothing was active
        twice, doubled or reordered.
    detected_s
        From the cut until the manager said so [s].
    active_s
        From the cut until what ran there was active elsewhere [s].
    active_twice
        Components that reached computers reported as active at the same time.
    lost
        Messages that were lost with the computer.
    """

    scene: str = "cut-link"
    ok: bool
    detected_s: float
    active_s: float
    active_twice: int
    lost: int
    doubled: int
    reordered: int


def cut_link(robot: Robot, say: Say, check: Check) -> CutLinkScene:
    """Cut off the computer of a component; RunError if that restarts nowhere."""
    placed = place(robot, method="static")
    twice: set[str] = set()
    with (
        emulated(robot, say=say) as computers,
        up(robot, placement=placed, say=say, check=check) as running,
    ):

        def look() -> Counter[str]:
            check()
            active = _active(running)
            twice.update(name for name, count in active.items() if count > 1)
            return active

        running.move(_MOVED, _CUT)
        wait(WARM_UP, look)
        say(f"'{_CUT}' is cut off from everything")
        began = time.monotonic()
        computers.cut(_CUT)
        detected = wait_until(lambda: _CUT in _lost(running), began, look)
        active = wait_until(lambda: look()[_MOVED] > 0, began, look)
        wait(_CUT_FOR - active, look)
        say("the link is healed")
        computers.heal(_CUT)
        wait_until(lambda: not _lost(running), time.monotonic(), look)
        wait_until(lambda: not running.status().deviations, time.monotonic(), look)
        wait(WARM_UP, look)
        is_whole = look() == Counter(running.status().placement.keys())
        counts = measures(running)
    wrong = len(twice), counts["doubled"], counts["reordered"]
    return CutLinkScene(
        ok=is_whole and not any(wrong),
        detected_s=detected,
        active_s=active,
        active_twice=len(twice),
        lost=counts["lost"],
        doubled=counts["doubled"],
        reordered=counts["reordered"],
    )


def _lost(running: Running) -> set[str]:
    return set(running.status().out_of_reach)


def _active(running: Running) -> Counter[str]:
    """Return how often each component is active on computers that are reached."""
    status = running.status()
    return Counter(
        component.name
        for computer, component in status.located()
        if computer not in status.out_of_reach and component.state == "active"
    )
