"""The phases of a task: which actions run at the same time, and what may follow what.

A phase is a set of actions. Steps one after another are phases one after another; of
a choice every branch is one; what is done on failure is one; what is repeated counts
once. Steps at once run at their own pace: every combination of their phases may come.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

from msgspec import Struct

from poise.errors import RobotError
from poise.model.robot import Robot
from poise.model.tasks.steps import (
    Action,
    Choice,
    Parallel,
    Repeat,
    Retry,
    Step,
    Subtask,
)

MOST_PHASES = 100
"""A task has no more phases than this."""


class TooManyPhasesError(RobotError):
    """A task has more than `MOST_PHASES` phases."""


class Phase(Struct, frozen=True, kw_only=True):
    """Actions that run at the same time.

    Parameters
    ----------
    name
        The names of its actions, joined with ``+``; those of another task's steps
        begin with its name, as in ``greet.wave``.
    after
        The names of the phases that it may follow.
    """

    name: str
    actions: tuple[Action, ...]
    after: tuple[str, ...] = ()

    @property
    def functions(self) -> tuple[str, ...]:
        """All functions that its actions need, each once, in order."""
        return tuple(dict.fromkeys(f for a in self.actions for f in a.functions))


def phases_of(robot: Robot, task: str) -> tuple[Phase, ...]:
    """Return the phases of a task, those that come first first.

    Raises
    ------
    KeyError
        There is no such task, or one that it names.
    RobotError
        It is a step of itself, or has too many phases.
    """
    flow = _Flows(robot, task).of_task(task, ())
    before: dict[_Node, list[str]] = {node: [] for node in flow.nodes}
    for first, then in flow.edges:
        if first != then:
            before[then].append(_name(first))
    return tuple(
        Phase(
            name=_name(node),
            actions=tuple(action for _, action in node),
            after=tuple(names),
        )
        for node, names in before.items()
    )


_Node = tuple[tuple[str, Action], ...]
"""Actions that run at the same time, each with its name."""


def _name(node: _Node) -> str:
    return "+".join(name for name, _ in node)


class _Flow(Struct, frozen=True):
    """What may follow what; `first` and `last` are where it begins and ends."""

    nodes: tuple[_Node, ...]
    edges: tuple[tuple[_Node, _Node], ...]
    first: tuple[_Node, ...]
    last: tuple[_Node, ...]


def _flow(
    nodes: Iterable[_Node],
    edges: Iterable[tuple[_Node, _Node]],
    first: Iterable[_Node],
    last: Iterable[_Node],
) -> _Flow:
    """Return a flow in which everything is once."""
    parts = [tuple(dict.fromkeys(part)) for part in (nodes, first, last)]
    if len(parts[0]) > MOST_PHASES:
        raise TooManyPhasesError(f"a task has more than {MOST_PHASES} phases")
    return _Flow(parts[0], tuple(dict.fromkeys(edges)), parts[1], parts[2])


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
                return _at_once([self._of(each, tasks) for each in steps])
            case Choice(steps=steps):
                return _either([self._of(each, tasks) for each in steps])
        once = self._of_sequence(step.steps, tasks)
        if isinstance(step, Repeat) and step.times != 1:
            again = product(once.last, once.first)
            return _flow(once.nodes, (*once.edges, *again), once.first, once.last)
        return once

    def _of_sequence(self, steps: Iterable[Step], tasks: tuple[str, ...]) -> _Flow:
        first, *others = (self._of(each, tasks) for each in steps)
        whole = first
        for then in others:
            whole = _flow(
                (*whole.nodes, *then.nodes),
                (*whole.edges, *product(whole.last, then.first), *then.edges),
                whole.first,
                then.last,
            )
        return whole

    def _of_action(self, action: Action, tasks: tuple[str, ...]) -> _Flow:
        prefix = "" if tasks == (self._task,) else f"{tasks[-1]}."
        node: _Node = ((prefix + action.name, action),)
        failed = action.on_failure
        then = failed.then if isinstance(failed, Retry) else failed
        if then == "give up":
            return _Flow((node,), (), (node,), (node,))
        instead = self._of(then, tasks)
        return _flow(
            (node, *instead.nodes),
            (*product([node], instead.first), *instead.edges),
            (node,),
            (node, *instead.last),
        )


def _either(flows: Iterable[_Flow]) -> _Flow:
    flows = tuple(flows)
    return _flow(
        (node for flow in flows for node in flow.nodes),
        (edge for flow in flows for edge in flow.edges),
        (node for flow in flows for node in flow.first),
        (node for flow in flows for node in flow.last),
    )


def _at_once(flows: Iterable[_Flow]) -> _Flow:
    whole, *others = flows
    for flow in others:
        pairs = [*product(whole.nodes, flow.nodes)]
        if len(pairs) > MOST_PHASES:
            raise TooManyPhasesError(f"a task has more than {MOST_PHASES} phases")
        here = [(a + c, b + c) for a, b in whole.edges for c in flow.nodes]
        there = [(c + a, c + b) for a, b in flow.edges for c in whole.nodes]
        whole = _flow(
            (a + b for a, b in pairs),
            (*here, *there),
            (a + b for a, b in product(whole.first, flow.first)),
            (a + b for a, b in product(whole.last, flow.last)),
        )
    return whole
