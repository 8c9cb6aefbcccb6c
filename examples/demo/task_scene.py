"""Three tasks share functions: one pauses another, and what comes next is prepared."""

from __future__ import annotations

import time
from collections.abc import Callable

from msgspec import Struct
from msgspec.structs import replace

from examples.demo.overload import Deadlines
from examples.demo.waiting import Check, Say, wait_until
from poise import Robot, Running, Status, up
from poise.model import Prefetch

_TOLD = ("action ", "task ", "switched ")
"""What of the journal a newcomer wants to read begins so, ..."""
_ALSO = (" prepared", "no action needed it")
"""... or says so."""


class TaskOutcome(Struct, frozen=True, kw_only=True):
    """How a task ended: ``done``, ``failed`` or ``cancelled``."""

    name: str
    outcome: str


class TasksScene(Struct, frozen=True, kw_only=True):
    """Three tasks, of which one has a higher priority.

    Parameters
    ----------
    ok
        Whether all were done, one waited for another, and both kinds of switches were.
    switch_hit_s, switch_miss_s
        From an action to the next whose components were prepared, and were not: medians
        [s].
    deadlines_missed
        By all components, in both plays.
    """

    scene: str = "tasks"
    ok: bool
    tasks: tuple[TaskOutcome, ...]
    switch_hit_s: float
    switch_miss_s: float
    deadlines_missed: int


def tasks(robot: Robot, say: Say, check: Check) -> TasksScene:
    """Play a task without prefetch, and three with it."""
    say("without prefetch: a task alone")
    plain = replace(robot, prefetch=Prefetch(off=True))
    _, before, missed_before = _play(plain, say, check, _wait_for_all)
    say("with prefetch: three tasks, of which 'wave' has the highest priority")
    outcomes, after, missed = _play(robot, say, check, _start_others)
    hit, miss = after.prefetch.hit, before.prefetch.miss
    return TasksScene(
        ok=all(each.outcome == "done" for each in outcomes)
        and hit.count > 0
        and miss.count > 0,
        tasks=outcomes,
        switch_hit_s=hit.median,
        switch_miss_s=miss.median,
        deadlines_missed=missed_before + missed,
    )


def _play(
    robot: Robot,
    say: Say,
    check: Check,
    act: Callable[[Running, Callable[[], object]], None],
) -> tuple[tuple[TaskOutcome, ...], Status, int]:
    """Play the first task; return how all went, and how many deadlines were missed."""
    began = time.monotonic()

    def tell(sentence: str) -> None:
        text = sentence.partition(" ")[2]  # without the time of day
        if text.startswith(_TOLD) or any(words in text for words in _ALSO):
            say(f"{time.monotonic() - began:5.1f} s  {text}")

    with up(robot, say=tell, check=check) as running:
        count = Deadlines(running)

        def look() -> None:
            check()
            count.look()

        act(running, look)
        count.look()
        outcomes = tuple(
            TaskOutcome(name=each.name, outcome=each.state)
            for each in running.tasks.started()
        )
        return outcomes, running.status(), count.missed


def _start_others(running: Running, look: Callable[[], object]) -> None:
    """Start a task that shares, and one that takes the arm from the first."""
    running.tasks.start("watch")
    began = time.monotonic()
    wait_until(lambda: _works(running, "fetch", "grasp"), began, look)
    running.tasks.start("wave")
    wait_until(lambda: running.tasks.show("fetch").state == "waiting", began, look)
    _wait_for_all(running, look)


def _wait_for_all(running: Running, look: Callable[[], object]) -> None:
    going = {"going", "waiting"}
    wait_until(
        lambda: all(each.state not in going for each in running.tasks.started()),
        time.monotonic(),
        look,
    )


def _works(running: Running, task: str, action: str) -> bool:
    actions = running.tasks.show(task).actions
    return any(each.name == action and each.is_at_work for each in actions)
