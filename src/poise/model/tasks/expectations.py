"""How long actions last and how they end, as far as a robot file and learning say it.

What nobody says is assumed, and `assumed` lists it for people.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import prod

from poise.model.robot import Robot
from poise.model.tasks.steps import Action, Choice, Repeat, Step, Subtask, steps_of

SECONDS = 30.0
"""An action without a limit is taken to last so long [s]."""
SUCCESS = 0.5
"""Of which nothing is learned, and the task says what is done when it fails: it does so
every other time, as with the prior of what is learned."""
ROUNDS = 10
"""So often is repeated what has no number of times."""
MOST_ROUNDS = 10**6
"""A larger number of rounds or retries counts as this."""


def seconds_of(action: Action) -> float:
    """Return how long an action is expected to last [s]: its limit."""
    return SECONDS if action.limit is None else action.limit


def rounds_of(repeat: Repeat) -> int:
    """Return how often steps are expected to be repeated."""
    return min(ROUNDS if repeat.times is None else repeat.times, MOST_ROUNDS)


def success_of(robot: Robot, action: Action) -> float:
    """Return how often an action is expected to succeed, in (0, 1].

    As was learned of the best architectures for it; where nothing was, `SUCCESS` if the
    task says what is done when it fails, else always.
    """
    learned = _learned(robot, action)
    if learned < 1:
        return learned
    return 1.0 if action.on_failure == "give up" else SUCCESS


def _learned(robot: Robot, action: Action) -> float:
    """Return the success that was learned, 1 where none was."""
    return prod(
        max((a.quality * a.success, a.success) for a in serving)[1]
        for f in action.functions
        if (serving := [a for a in robot.architectures if a.function == f])
    )


def promise_of(robot: Robot, action: Action) -> float:
    """Return the quality of the best architectures for an action times their success.

    What has no architecture promises nothing.
    """
    return prod(
        max(
            (a.quality * a.success for a in robot.architectures if a.function == f),
            default=0.0,
        )
        for f in action.functions
    )


def shares_of(robot: Robot, choice: Choice) -> list[float]:
    """Return how often each step of a choice is expected: in proportion to promises."""
    promises = [promise_of(robot, first_action(robot, step)) for step in choice.steps]
    total = sum(promises)
    count = len(promises)
    return [p / total for p in promises] if total > 0 else [1 / count] * count


def first_action(robot: Robot, step: Step) -> Action:
    """Return the first action of a step; of steps at once, of the first of them."""
    while not isinstance(step, Action):
        inner = (
            robot.task(step.task).actions if isinstance(step, Subtask) else step.steps
        )
        step = inner[0]
    return step


def assumed(robot: Robot, task: str) -> Iterator[str]:
    """Yield what is assumed of a task, because nobody says it, for people."""
    steps = list(steps_of({each.name: each for each in robot.tasks}, task))
    actions = [step for step in steps if isinstance(step, Action)]
    timeless = [a.name for a in actions if a.limit is None]
    if timeless:
        whose = "every action" if len(timeless) == len(actions) else _listed(timeless)
        yield f"{whose} takes {SECONDS:g} s, as it has no limit"
    unknown = [
        a.name for a in actions if a.on_failure != "give up" and _learned(robot, a) == 1
    ]
    if unknown:
        yield f"{_listed(unknown)} succeeds every other time, as nothing is learned"
    if any(isinstance(step, Choice) for step in steps):
        yield "steps of a choice are taken in proportion to what they promise"
    if any(isinstance(step, Repeat) and step.times is None for step in steps):
        yield f"what has no number of times is repeated {ROUNDS} times"


def _listed(names: list[str]) -> str:
    return " or ".join(names)
