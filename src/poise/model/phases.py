"""The phases of a task: which actions run at the same time, and what may follow what.

Steps at once run at their own pace, so every combination of their phases may come. How
long a run of the task is in a phase, and how often it goes from one to another, is what
is expected of its steps, each ending independently of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import product
from math import prod
from typing import Literal, TypeVar

from msgspec import Struct

from poise.errors import RobotError
from poise.model.robot import Architecture, Robot
from poise.model.steps import (
    Action,
    Choice,
    Parallel,
    Repeat,
    Retry,
    Step,
    Subtask,
    steps_of,
)

SECONDS = 30.0
"""An action without a limit is taken to last so long [s]."""
SUCCESS = 0.5
"""Of which nothing is learned, and the task says what is done when it fails: it does so
every other time, as with the prior of what is learned."""
ROUNDS = 10
"""So often is repeated what has no number of times."""
MOST_ROUNDS = 10**6
"""A larger number of rounds or retries counts as this."""


def promise_of(robot: Robot, action: Action) -> float:
    """Return quality x success of the best architectures for an action."""
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
    """Yield what is assumed of a task that its file does not say, for people."""
    steps = list(steps_of({t.name: t for t in robot.tasks}, task))
    actions = [step for step in steps if isinstance(step, Action)]
    timeless = [a.name for a in actions if a.limit is None]
    if timeless:
        is_all = len(timeless) == len(actions)
        whose = "every action" if is_all else " or ".join(timeless)
        yield f"{whose} takes {SECONDS:g} s, as it has no limit"
    unknown = [
        a.name
        for a in actions
        if a.on_failure != "give up" and a.name not in robot.success
    ]
    if unknown:
        names = " or ".join(unknown)
        yield f"{names} succeeds every other time, as nothing is learned"
    if any(isinstance(step, Choice) for step in steps):
        yield "steps of a choice are taken in proportion to what they promise"
    if any(isinstance(step, Repeat) and step.times is None for step in steps):
        yield f"repetitions without a number of times are done {ROUNDS} times"


MOST_PHASES = 100
"""A task has no more phases than this."""
LEAST_SHARE = 1e-4
"""No phase lasts less than this share of the task: each is placed well by itself."""


class TooManyPhasesError(RobotError):
    """A task has more than `MOST_PHASES` phases."""


class Phase(Struct, frozen=True, kw_only=True):
    """Actions that run at the same time."""

    # the names of its actions, joined with ``+``; those of another task's steps begin
    # with its name, as in ``greet.wave``
    name: str
    actions: tuple[Action, ...]
    # the names of the phases that it may follow, and how often it is expected to in a
    # run of the task
    after: Mapping[str, float] = {}
    lasts: float  # how long a run of the task is expected to be in it, in all [s]

    @property
    def functions(self) -> tuple[str, ...]:
        """All functions that its actions need, each once, in order."""
        return tuple(dict.fromkeys(f for a in self.actions for f in a.functions))


def phases_of(robot: Robot, task: str) -> tuple[Phase, ...]:
    """Return the phases of a task, those that come first first."""
    flow = _Flows(robot, task).of_task(task, ())
    after: dict[_Node, dict[str, float]] = {node: {} for node in flow.lasts}
    for (first, then), often in flow.edges.items():
        if first != then:
            after[then][_name(first)] = often
    least = LEAST_SHARE * sum(flow.lasts.values())
    return tuple(
        Phase(
            name=_name(node),
            actions=tuple(action for _, action in node),
            after=after[node],
            lasts=max(lasts, least),
        )
        for node, lasts in flow.lasts.items()
    )


_Node = tuple[tuple[str, Action], ...]
"""Actions that run at the same time, each with its name."""
_Odds = dict[_Node, float]
"""How often something is expected at each."""


def _name(node: _Node) -> str:
    return "+".join(name for name, _ in node)


class _Flow(Struct, frozen=True):
    """What is expected of some steps, whenever they are begun."""

    lasts: _Odds  # how long each node lasts in all [s]
    edges: dict[tuple[_Node, _Node], float]  # how often one follows another
    # first, last: How often they begin with each, and are done with it; else they have
    # failed
    first: _Odds
    last: _Odds

    @property
    def done(self) -> float:
        """How often they are done, in [0, 1]."""
        return sum(self.last.values())


_Key = TypeVar("_Key")


def _sum(*parts: tuple[float, Mapping[_Key, float]]) -> dict[_Key, float]:
    """Return the sum of what is expected, each part so often."""
    total: dict[_Key, float] = {}
    for often, part in parts:
        for key, value in part.items():
            total[key] = total.get(key, 0.0) + often * value
    return total


def _between(last: _Odds, first: _Odds) -> dict[tuple[_Node, _Node], float]:
    """Return how often one follows another where these are done, then those begun."""
    return {(a, b): x * y for (a, x), (b, y) in product(last.items(), first.items())}


def _within(lasts: _Odds) -> _Odds:
    if len(lasts) > MOST_PHASES:
        raise TooManyPhasesError(f"a task has more than {MOST_PHASES} phases")
    return lasts


class _Flows:
    """The flows of the steps of a task."""

    def __init__(self, robot: Robot, task: str) -> None:
        self._robot = robot
        self._task = task

    def of_task(self, name: str, outer: tuple[str, ...]) -> _Flow:
        if name in outer:
            way = " -> ".join([*outer, name])
            raise RobotError(f"a task cannot be a step of itself: {way}")
        task = self._robot.task(name)
        return self._of_sequence(task.actions, (*outer, name))

    def _of(self, step: Step, tasks: tuple[str, ...]) -> _Flow:
        match step:
            case Action():
                return self._of_action(step, tasks)
            case Subtask(task=name):
                return self.of_task(name, tasks)
            case Parallel(steps=steps):
                return _at_once([self._of(step, tasks) for step in steps])
            case Choice(steps=steps):
                flows = [self._of(step, tasks) for step in steps]
                return _either(flows, shares_of(self._robot, step))
        once = self._of_sequence(step.steps, tasks)
        if not isinstance(step, Repeat) or step.times == 1:
            return once
        rounds = ROUNDS if step.times is None else min(step.times, MOST_ROUNDS)
        return _again(once, rounds)

    def _of_sequence(self, steps: Iterable[Step], tasks: tuple[str, ...]) -> _Flow:
        whole, *others = (self._of(step, tasks) for step in steps)
        for then in others:
            done = whole.done
            whole = _Flow(
                _within(_sum((1, whole.lasts), (done, then.lasts))),
                _sum(
                    (1, whole.edges),
                    (1, _between(whole.last, then.first)),
                    (done, then.edges),
                ),
                whole.first,
                _sum((done, then.last)),
            )
        return whole

    def _of_action(self, action: Action, tasks: tuple[str, ...]) -> _Flow:
        prefix = "" if tasks == (self._task,) else f"{tasks[-1]}."
        node: _Node = ((prefix + action.name, action),)
        retry, then = 0, action.on_failure
        if isinstance(then, Retry):
            retry, then = min(then.times, MOST_ROUNDS), then.then
        unknown = 1.0 if action.on_failure == "give up" else SUCCESS
        fails = 1 - self._robot.success.get(action.name, unknown)
        failed = fails ** (retry + 1)
        once = SECONDS if action.limit is None else action.limit
        lasts = once * _series(fails, retry + 1)
        own = _Flow({node: lasts}, {}, {node: 1.0}, {node: 1 - failed})
        if then == "give up":
            return own
        instead = self._of(then, tasks)
        return _Flow(
            _within(_sum((1, own.lasts), (failed, instead.lasts))),
            _sum((failed, _between(own.first, instead.first)), (failed, instead.edges)),
            own.first,
            _sum((1, own.last), (failed, instead.last)),
        )


def _series(factor: float, count: int) -> float:
    """Return 1 + factor + factor^2 and so on, `count` terms; factor is in [0, 1]."""
    return count if factor == 1 else (1 - factor**count) / (1 - factor)


def _again(once: _Flow, rounds: int) -> _Flow:
    """Return steps that are done several times, as long as they do not fail."""
    begun = _series(once.done, rounds)
    # each round but the first follows one that was done
    again = (begun - 1) / once.done if once.done > 0 else 0.0
    return _Flow(
        _sum((begun, once.lasts)),
        _sum((begun, once.edges), (again, _between(once.last, once.first))),
        once.first,
        _sum((once.done ** (rounds - 1), once.last)),
    )


def _either(flows: Iterable[_Flow], shares: Iterable[float]) -> _Flow:
    parts = [*zip(shares, flows, strict=True)]
    return _Flow(
        _within(_sum(*((share, flow.lasts) for share, flow in parts))),
        _sum(*((share, flow.edges) for share, flow in parts)),
        _sum(*((share, flow.first) for share, flow in parts)),
        _sum(*((share, flow.last) for share, flow in parts)),
    )


def _at_once(flows: Iterable[_Flow]) -> _Flow:
    """Return steps at once: while one is somewhere, another may be anywhere."""
    one, *others = flows
    for two in others:
        lasts = max(sum(one.lasts.values()), sum(two.lasts.values()))
        here, there = _shares(one.lasts), _shares(two.lasts)
        one = _Flow(
            _within(_both(here, there, lasts)),
            {
                (a + c, b + c): often * share
                for ((a, b), often), (c, share) in product(
                    one.edges.items(), there.items()
                )
            }
            | {
                (a + c, a + d): often * share
                for (a, share), ((c, d), often) in product(
                    here.items(), two.edges.items()
                )
            },
            _both(one.first, two.first),
            _both(one.last, two.last),
        )
    return one


def _shares(lasts: _Odds) -> _Odds:
    total = sum(lasts.values())
    return {node: seconds / total for node, seconds in lasts.items()}


def _both(one: _Odds, two: _Odds, times: float = 1.0) -> _Odds:
    """Return what is expected of pairs that know nothing of each other."""
    return {
        a + b: times * x * y for (a, x), (b, y) in product(one.items(), two.items())
    }


class Clash(Struct, frozen=True, kw_only=True):
    """An exclusive device or function that several would use at the same time."""

    kind: Literal["device", "function"]
    name: str
    # for a function the actions that need it; for a device ``function of action``
    users: tuple[str, ...]

    def __str__(self) -> str:
        users = " and ".join(self.users)
        return (
            f"{users} would use the {self.kind} '{self.name}' at the same time, which "
            "is exclusive"
        )


def clashes(robot: Robot, actions: Iterable[Action]) -> Iterator[Clash]:
    """Yield what actions that run at once cannot share.

    Of a function with alternatives, only devices that all of them need count: the
    others can be avoided.
    """
    actions = tuple(actions)
    exclusive = {a.function for a in robot.architectures if a.exclusive}
    for function in sorted(exclusive):
        users = tuple(f"'{a.name}'" for a in actions if function in a.functions)
        if len(users) > 1:
            yield Clash(kind="function", name=function, users=users)
    pairs = [(a.name, f) for a in actions for f in dict.fromkeys(a.functions)]
    for device in robot.devices:
        if not device.exclusive:
            continue
        users = tuple(
            f"'{function}' of '{action}'"
            for action, function in pairs
            if _always_needs(robot, function, device.name)
        )
        if len(users) > 1:
            yield Clash(kind="device", name=device.name, users=users)


def _always_needs(robot: Robot, function: str, device: str) -> bool:
    every = [a for a in robot.architectures if a.function == function]
    return bool(every) and all(needs_device(a, device) for a in every)


def needs_device(architecture: Architecture, device: str) -> bool:
    """Return whether some component of an architecture needs a device."""
    return any(device in component.devices for component in architecture.components)
