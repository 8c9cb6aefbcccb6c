"""A chain over three computers, whose middle must move while something is broken."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct

from examples.demo.overlaps import overlaps, read_handler_log
from examples.demo.waiting import WARM_UP, Check, Say, measures, wait, wait_until
from poise import Robot, Running, emulated, place, up
from poise.emulate import EmulatedSet

_MOVED, _END = "relay", "sink"
_BROKEN_FOR = 6.0
"""Longer than any adaptation should take [s]."""


class RelayScene(Struct, frozen=True, kw_only=True):
    """A link of a chain is cut, or the agent at its middle is stopped.

    Parameters
    ----------
    ok
        Whether the middle moved before all was mended, no component was active twice,
        and no message came twice or late.
    moved_s
        Until it worked elsewhere and the end of the chain got a message [s]; None: it
        did not while it was broken.
    active_twice
        Components of which two incarnations worked at the same time, by the logs that
        they write themselves.
    beside_s
        For how long at most [s].
    lost
        Messages that never came to the end of the chain.
    """

    scene: str
    ok: bool
    moved_s: float | None
    active_twice: int
    beside_s: float
    lost: int
    doubled: int
    reordered: int


def cut_one_link(robot: Robot, say: Say, check: Check) -> RelayScene:
    """Cut the link from the middle to the end of the chain, and that link alone."""

    def break_it(computers: EmulatedSet) -> None:
        say("the link of 'a' and 'b' is cut, and no other")
        computers.cut("a", "b")

    def mend(computers: EmulatedSet) -> None:
        say("the link is healed")
        computers.heal("a", "b")

    return _play("cut-one-link", robot, say, check, break_it, mend)


def freeze_agent(robot: Robot, say: Say, check: Check) -> RelayScene:
    """Stop the agent's process of a computer, but not its containers."""

    def break_it(computers: EmulatedSet) -> None:
        say("the agent of 'a' is stopped; its containers go on")
        computers.freeze("a", agent=True)

    def mend(computers: EmulatedSet) -> None:
        say("the agent goes on")
        computers.boot("a")

    return _play("frozen-agent", robot, say, check, break_it, mend)


def _play(
    scene: str,
    robot: Robot,
    say: Say,
    check: Check,
    break_it: Callable[[EmulatedSet], None],
    mend: Callable[[EmulatedSet], None],
) -> RelayScene:
    """Break and mend the robot; RunError if it is not as it should be afterwards."""
    folder = Path(robot.folder, "handler-log")
    folder.mkdir()
    with (
        emulated(robot, say=say) as computers,
        up(
            robot, placement=place(robot, method="static"), say=say, check=check
        ) as running,
    ):
        wait_until(lambda: not running.status().deviations, time.monotonic(), check)
        wait(WARM_UP, check)
        began = time.monotonic()
        break_it(computers)
        wait(_BROKEN_FOR, check)
        moved = _moved(folder, began)
        if moved is None:
            say(f"'{_MOVED}' did not move within {_BROKEN_FOR:g} s")
        mend(computers)
        wait_until(lambda: _is_well(running), time.monotonic(), check)
        wait(WARM_UP, check)
        counts = measures(running)
    twice = overlaps(read_handler_log(folder))
    for each in twice:
        say(str(each))
    wrong = len(twice), counts["doubled"], counts["reordered"]
    return RelayScene(
        scene=scene,
        ok=moved is not None and not any(wrong),
        moved_s=moved,
        active_twice=len({each.component for each in twice}),
        beside_s=max((each.until - each.since for each in twice), default=0.0),
        lost=counts["lost"],
        doubled=counts["doubled"],
        reordered=counts["reordered"],
    )


def _is_well(running: Running) -> bool:
    status = running.status()
    return not status.deviations and not status.out_of_reach


def _moved(folder: Path, since: float) -> float | None:
    """Return how long after `since` the chain worked with its middle elsewhere [s]."""
    logs = read_handler_log(folder)
    elsewhere = [
        begin
        for log in logs
        if log.component == _MOVED and (begin := log.runs[0].begin) > since
    ]
    if not elsewhere:
        return None
    got = [
        run.begin
        for log in logs
        if log.component == _END
        for run in log.runs
        if run.begin > min(elsewhere)
    ]
    return min(got) - since if got else None
