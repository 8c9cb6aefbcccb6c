"""The computer of a robot's manager loses power, and another computer leads."""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from examples.demo.overlaps import overlaps, read_handler_log
from examples.demo.waiting import WARM_UP, Check, Say, wait, wait_until
from poise import PoiseError, Robot, Running, emulated
from poise.emulate import EmulatedSet
from poise.model import load

_LEADS, _MOVES = "a", "relay"
_TASKS = {"relay", "again"}
_MORE = """
  again: {actions: [{name: relay, functions: [relaying]}]}
manager: [a, b, c]
"""
"""What the robot of the relay lacks: another task, and standbys."""
_END_LIMIT = 20.0
_OVER = {"done", "failed", "cancelled"}


class LostLeaderScene(Struct, frozen=True, kw_only=True):
    """The computer where the leader and a movable component run loses power.

    Parameters
    ----------
    ok
        Whether another leader went on with everything.
    detected_s
        Until the next leader knew of it [s].
    leader_s
        Until that one answered a command [s].
    active_s
        Until the component worked on another computer [s].
    active_twice
        Components of which two incarnations worked at the same time, by their own logs.
    tasks_lost
        Tasks that were started, the last one just before, and did not go on.
    """

    scene: str = "lost-leader"
    ok: bool
    detected_s: float
    leader_s: float
    active_s: float
    active_twice: int
    tasks_lost: int


def lose_leader(robot: Robot, say: Say, check: Check) -> LostLeaderScene:
    """Crash the leader's computer; RunError if no other one leads."""
    file = Path(robot.folder, "robot.yaml")
    file.write_text(file.read_text() + _MORE)
    logs = Path(robot.folder, "handler-log")
    logs.mkdir()
    # managers on emulated computers have temporary folders of their own
    os.environ["XDG_RUNTIME_DIR"] = robot.folder
    robot, running = load(file), Running(robot.name)
    with (
        emulated(robot, say=say) as computers,
        _first_manager(computers, file) as first,
    ):
        wait_until(lambda: _is_well(running), time.monotonic(), check)
        wait(WARM_UP, check)
        running.tasks.start("again")
        say(f"'{_LEADS}' loses power, with the manager and '{_MOVES}' on it")
        began = time.monotonic()
        at = time.time()  # noqa: TID251 - as `out_of_reach` has it
        computers.crash(_LEADS)
        leader = wait_until(lambda: _led_by_other(running, first), began, check)
        wait_until(lambda: _active_after(logs, began) is not None, began, check)
        status = running.status()
        wait(WARM_UP, check)
        lost = _TASKS - {
            t.name for t in running.tasks.started() if t.state not in _OVER
        }
        say("the power is back")
        computers.boot(_LEADS)
        wait_until(lambda: _is_well(running), time.monotonic(), check)
        running.stop()
    twice = overlaps(read_handler_log(logs))
    for each in twice:
        say(str(each))
    return LostLeaderScene(
        ok=not lost and not twice,
        detected_s=status.out_of_reach[_LEADS] - at,
        leader_s=leader,
        active_s=_active_after(logs, began) or math.inf,
        active_twice=len({each.component for each in twice}),
        tasks_lost=len(lost),
    )


@contextlib.contextmanager
def _first_manager(computers: EmulatedSet, file: Path) -> Iterator[int]:
    """Run `poise up` on the computer that will be lost; yield its process."""
    argv = [sys.executable, "-m", "poise", "up", str(file), "--task", "relay"]
    process = computers.computers[_LEADS].popen(
        [*argv, "--placement", "static"],
        stdin=subprocess.DEVNULL,
        stdout=sys.stderr.buffer,
    )
    try:
        yield process.pid
    finally:
        process.terminate()
        process.wait(_END_LIMIT)


def _is_well(running: Running) -> bool:
    with contextlib.suppress(PoiseError):  # nobody leads for a moment
        return not running.status().deviations
    return False


def _led_by_other(running: Running, first: int) -> bool:
    with contextlib.suppress(PoiseError):
        status = running.status()
        return not status.by_agents and status.manager.pid != first
    return False


def _active_after(folder: Path, began: float) -> float | None:
    """Return how long after `began` it worked elsewhere [s]; None: not yet."""
    first = [
        log.runs[0].begin
        for log in read_handler_log(folder)
        if log.component == _MOVES and log.runs[0].begin > began
    ]
    return min(first) - began if first else None
