"""The sequence diagram of a transition: who tells whom what while components move."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from poise.manage.migration.report import TransitionStep
from poise.model.robot import Robot
from poise.session.diagrams.records import Arrow, SequenceDiagram
from poise.units import format_bytes

MANAGER = "manager"


def sequence_diagram(
    robot: Robot, title: str, steps: Iterable[TransitionStep]
) -> SequenceDiagram:
    """Return the steps as messages between the manager and the agents of computers."""
    states = {each.name: each.state for each in robot.components()}
    messages = tuple(
        message
        for step in steps
        for message in _messages(step, states.get(step.component, 0.0))
    )
    used = {name for each in messages for name in (each.source, each.target)}
    computers = [c.name for c in robot.computers if c.name in used]
    return SequenceDiagram(f"{robot.name}: {title}", (MANAGER, *computers), messages)


def _messages(step: TransitionStep, state: float) -> Iterator[Arrow]:
    """Yield what a step takes; docs/design/moves.md has all of its parts."""
    name, source, target = step.component, step.source, step.target
    why = f" ({step.why})" if step.why else ""
    if not step.source:
        yield Arrow(MANAGER, target, f"start {name}{why}")
    elif not step.target:
        yield Arrow(MANAGER, source, f"stop {name}{why}")
    else:
        size = f", {format_bytes(state)}" if state else ""
        yield Arrow(MANAGER, target, f"prepare {name}{why}")
        yield Arrow(MANAGER, source, f"pause {name}")
        yield Arrow(source, target, f"state of {name}{size}")
        yield Arrow(MANAGER, target, f"resume {name}")
        yield Arrow(MANAGER, source, f"end {name}")
