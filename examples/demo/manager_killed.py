"""The manager is killed amid a move, and another one takes the robot over."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from examples.demo.waiting import (
    WARM_UP,
    Check,
    Say,
    active_components,
    measures,
    wait,
    wait_until,
)
from poise import PoiseError, Robot, Running, emulated

_MOVED, _HOME, _TARGET = "passer", "left", "right"
_AMID = 0.2
"""The manager is killed this long after the target of the move is there [s]: the state
takes 0.3 s to cross the link."""
_END_LIMIT = 20.0

Places = dict[str, tuple[str, int, int]]
"""Component -> computer, epoch and process."""


class ManagerKilledScene(Struct, frozen=True, kw_only=True):
    """The manager is killed amid a move.

    Parameters
    ----------
    ok
        Whether the robot went on, and no message was lost, doubled or reordered.
    back_s
        From the start of the next manager until it managed the robot [s].
    moved
        Components that it moved or restarted, but for the one whose move was half done.
    active_twice
        Components that were active twice afterwards.
    failed_calls
        Calls without an answer within their limit, as nobody finished the move.
    """

    scene: str = "manager-killed"
    ok: bool
    back_s: float
    moved: int
    active_twice: int
    lost: int
    doubled: int
    reordered: int
    failed_calls: int


def kill_manager(robot: Robot, say: Say, check: Check) -> ManagerKilledScene:
    """Kill the manager amid a move; RunError if no other takes the robot over."""
    running = Running(robot.name)
    with emulated(robot, say=say):
        with _manager(robot, "first manager", say) as first:
            began = time.monotonic()
            wait_until(lambda: _manages(running, first), began, check)
            wait(WARM_UP, check)
            # a busy machine may have held an agent up: a move would be refused
            wait_until(lambda: not running.status().deviations, began, check)
            before = _places(running)
            say(f"'{_MOVED}' is to move to '{_TARGET}'")
            threading.Thread(target=_move, args=(running,), daemon=True).start()
            wait_until(lambda: _is_prepared(running), time.monotonic(), check)
            wait(_AMID, check)
            first.kill()
        say("the manager was killed amid that move; another one is started")
        began = time.monotonic()
        with _manager(robot, "second manager", say) as second:
            back = wait_until(lambda: _manages(running, second), began, check)
            say(f"the robot is managed again after {back:.2f} s")
            wait_until(lambda: _is_whole(running), began, check)
            after = _places(running)
            target = _HOME if after[_MOVED][0] == _TARGET else _TARGET
            say(f"'{_MOVED}' is to move to '{target}'")
            try:
                running.move(_MOVED, target)
            except PoiseError as error:  # it was undone, as on a busy machine
                say(f"{error}; it is asked for again")
                wait(WARM_UP, check)
                running.move(_MOVED, target)
            wait(WARM_UP, check)
            scene = _outcome(running, back, before, after)
            running.stop()
    return scene


def _outcome(
    running: Running, back: float, before: Places, after: Places
) -> ManagerKilledScene:
    times = Counter(active_components(running))
    twice = sum(count > 1 for count in times.values())
    moved = sum(before[n] != after.get(n) for n in before if n != _MOVED)
    counts = measures(running)
    wrong = [counts[name] for name in ("lost", "doubled", "reordered")]
    return ManagerKilledScene(
        ok=times.keys() == before.keys() and not any([moved, twice, *wrong]),
        back_s=back,
        moved=moved,
        active_twice=twice,
        lost=counts["lost"],
        doubled=counts["doubled"],
        reordered=counts["reordered"],
        failed_calls=counts["failed"],
    )


@contextlib.contextmanager
def _manager(robot: Robot, name: str, say: Say) -> Iterator[subprocess.Popen[str]]:
    """Run `poise up` as a program of its own, and pass on what it says."""
    argv = [sys.executable, "-m", "poise", "up", str(Path(robot.folder, "robot.yaml"))]
    with subprocess.Popen(  # noqa: S603, Poise itself
        [*argv, "--placement", "static", "--no-adapt"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:

        def pass_on() -> None:
            for line in process.stdout or ():
                say(f"  {name}: {line.rstrip()}")

        reader = threading.Thread(target=pass_on, daemon=True)
        reader.start()
        try:
            yield process
        finally:
            process.terminate()
            process.wait(_END_LIMIT)
            reader.join(_END_LIMIT)


def _manages(running: Running, process: subprocess.Popen[str]) -> bool:
    if process.poll() is not None:
        return False
    try:
        return running.status().manager.pid == process.pid
    except PoiseError:  # it is still starting
        return False


def _move(running: Running) -> None:
    with contextlib.suppress(PoiseError):  # its manager is killed meanwhile
        running.move(_MOVED, _TARGET)


def _is_prepared(running: Running) -> bool:
    found = [c.name for _, c in running.status().located()]
    return found.count(_MOVED) > 1


def _is_whole(running: Running) -> bool:
    status = running.status()
    found = [c.name for _, c in status.located()]
    return sorted(found) == sorted(status.placement)


def _places(running: Running) -> Places:
    return {
        component.name: (computer, component.epoch, container.pid)
        for computer, status in running.status().computers.items()
        for container in status.containers
        for component in container.components
    }
