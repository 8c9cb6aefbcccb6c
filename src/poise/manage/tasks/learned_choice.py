"""Which step of a choice is done, and what is learned when actions end."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from poise.errors import PoiseError
from poise.estimate.success_rates import Conditions, Ending, learned, note_outcome
from poise.manage.adaptation.decision import shortages_of
from poise.manage.adaptation.situation import Situation
from poise.manage.journal import Journal
from poise.model.phases import first_action, promise_of
from poise.model.robot import Robot
from poise.model.steps import Choice


def choose(
    robot: Robot,
    choice: Choice,
    conditions: Conditions,
    note: Callable[[str], object],
    *,
    explore: bool = False,
) -> int:
    """Return which step of a choice promises most; of equals the first."""
    promises = []
    for step in choice.steps:
        action = first_action(robot, step)
        known = learned(robot, [action], conditions=conditions, explore=explore).robot
        promises.append((action.name, promise_of(known, action)))
    best = max(range(len(promises)), key=lambda index: promises[index][1])
    said = ", ".join(f"'{name}' {promise:.0%}" for name, promise in promises)
    note(f"choice of '{promises[best][0]}': promised are {said}")
    return best


def conditions_of(situation: Situation) -> Conditions:
    """Return the conditions of a robot, for which success is learned."""
    return Conditions(
        lost=tuple(situation.lost),
        cpu_is_short=any(short > 0 for short in shortages_of(situation).values()),
    )


def note_ending(
    robot: Robot,
    journal: Journal,
    action: str,
    architectures: Iterable[str],
    conditions: Conditions,
    *,
    done: bool,
) -> None:
    """Note how an action ended, with what served it; say so when it cannot be kept."""
    names = tuple(architectures)
    if not robot.folder or not names:
        return
    ending: Ending = "done" if done else "failed"
    try:
        note_outcome(robot, action, ending, names, conditions=conditions)
    except PoiseError as error:
        journal.note("failed", f"the outcome of '{action}' is not learned: {error}")
