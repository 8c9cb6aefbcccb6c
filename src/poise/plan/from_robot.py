"""From a robot to the problem of where its components go."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

from poise.errors import RobotError, UsageError
from poise.model import robot as model
from poise.model.check.allowed_computers import Pins, pins
from poise.model.phases import needs_device
from poise.plan.alternatives import part
from poise.plan.problem.items import Bundle, Edge, Hop, Item, TimeLimit
from poise.plan.problem.problem import Problem, needs

LATENESS_PRICE = 10.0
"""What F grows by when data takes twice as long as its deadline says: more than all
other terms of a normalised F."""
MEGABYTE = 1e6


def problem_of(
    robot: model.Robot,
    task: str | None = None,
    *,
    functions: Iterable[str] | None = None,
    present: Mapping[str, str] | None = None,
    move: float = 0.0,
) -> Problem:
    """Return the problem of placing what a task of `robot` needs.

    Parameters
    ----------
    task
        Name of the task; None means all architectures of the robot.
    functions
        Names of functions, instead of a task.
    present
        Component -> computer, as it is now. Components that may not be moved while
        they run stay there; computers that are gone are passed over. An architecture
        that can run nowhere is, too, where an alternative can run.
    move
        What F grows by for moving a component, plus as much for each MB of its state.

    Raises
    ------
    RobotError
        When a function is not there, or all that provides one has components that can
        run nowhere; the message lists all.
    UsageError
        When there is no such task.
    """
    robot = robot.on(robot.hosts)
    chosen = _architectures(robot, task, functions)
    items: dict[str, list[Item]] = {}
    faults: dict[str, list[str]] = {}
    for a in chosen:
        faults[a.name] = []
        items[a.name] = [
            _component(robot, a, c, present or {}, move, faults[a.name])
            for c in a.components
        ]
    provided = {a.function for a in chosen if not faults[a.name]}
    if lacking := [a for a in chosen if a.function not in provided]:
        why = "\n  ".join(fault for a in lacking for fault in faults[a.name])
        raise RobotError(f"no placement is possible:\n  {why}")
    chosen = [a for a in chosen if not faults[a.name]]
    components = tuple(item for a in chosen for item in items[a.name])
    names = {c.name for c in components}
    return Problem(
        components=components,
        computers=robot.computers,
        connectors=tuple(_connectors(robot, chosen, names)),
        links=robot.links,
        objective=robot.objective,
        together=_within(robot.together, names),
        apart=_within(robot.apart, names),
        exclusive=dict(_exclusive(robot, chosen)),
        architectures=tuple(
            Bundle(
                name=a.name,
                components=tuple(c.name for c in a.components),
                function=a.function,
                priority=a.priority,
                quality=a.quality * a.success,
                required=a.layer != "sequencing",
            )
            for a in chosen
        ),
        time_limits=tuple(_time_limits(robot, names)),
    )


def static(robot: model.Robot, problem: Problem) -> dict[str, str]:
    """Return the static placement: every architecture on its home computer.

    Of alternatives the best one is placed (the first of equals), as only one of them
    runs. A component that cannot run on its home (its device is elsewhere) goes to the
    first computer that it may run on; so does one without a home.
    """
    homes = {c.name: a.home for a in robot.architectures for c in a.components}
    placement = {}
    for component in part(problem, [need[0] for need in needs(problem)]).components:
        home = homes.get(component.name)
        choices = component.only or tuple(h.name for h in problem.computers)
        placement[component.name] = home if home in choices else choices[0]
    return placement


def _architectures(
    robot: model.Robot, task: str | None, functions: Iterable[str] | None
) -> list[model.Architecture]:
    if functions is None:
        if task is None:
            return _without_rivals(list(robot.architectures))
        check_task(robot, task)
        functions = robot.functions_of(task)
    wanted = set(functions)
    missing = sorted(wanted - {a.function for a in robot.architectures})
    if missing:
        names = ", ".join(repr(name) for name in missing)
        raise RobotError(f"no architecture of robot {robot.name!r} provides {names}")
    return _without_rivals([a for a in robot.architectures if a.function in wanted])


def check_task(robot: model.Robot, task: str) -> None:
    """Raise UsageError when a robot has no such task."""
    known = [t.name for t in robot.tasks]
    if task not in known:
        choices = ", ".join(known) or "none"
        raise UsageError(
            f"robot {robot.name!r} has no task {task!r} (its tasks: {choices})"
        )


def _without_rivals(
    architectures: list[model.Architecture],
) -> list[model.Architecture]:
    """Return them with one architecture for each reactive or deliberative function."""
    first: dict[str, str] = {}
    for a in architectures:
        if a.layer != "sequencing":
            first.setdefault(a.function, a.name)
    return [a for a in architectures if first.get(a.function, a.name) == a.name]


def _component(
    robot: model.Robot,
    architecture: model.Architecture,
    component: model.ComponentEntry,
    present: Mapping[str, str],
    move: float,
    faults: list[str],
) -> Item:
    there = {h.name for h in robot.computers}
    now = present.get(component.name)
    if now not in there:
        now = None
    only: tuple[str, ...] | None = None
    reasons = []
    for names, reason in _pins(robot, architecture, component, now):
        only = names if only is None else tuple(h for h in only if h in names)
        reasons.append(reason)
    if only and (gone := sorted({*only} - there)):
        only = tuple(h for h in only if h in there)
        reasons.append(f"{' and '.join(gone)} not available")
    why = "; ".join(reasons)
    if only == ():
        faults.append(f"component {component.name!r} can run nowhere: {why}")
    return Item(
        name=component.name,
        demand=component.demand,
        only=only or (),
        present=now,
        move_cost=move * (1 + component.state / MEGABYTE) if move else 0.0,
        why=why,
    )


def _pins(
    robot: model.Robot,
    architecture: model.Architecture,
    component: model.ComponentEntry,
    now: str | None,
) -> Pins:
    """Yield where a component is held to, by the robot file and by where it runs."""
    yield from pins(robot, architecture, component, layers_stay=now is None)
    if now is not None and architecture.layer != "sequencing":
        yield (now,), f"runs on {now}, and the {architecture.layer} layer does not move"
    elif now is not None and not component.movable:
        yield (now,), f"runs on {now} and may not be moved"


def _connectors(
    robot: model.Robot, chosen: list[model.Architecture], names: set[str]
) -> Iterator[Edge]:
    for connectors in (*(a.connectors for a in chosen), robot.connectors):
        for connector in connectors:
            ends = connector.between
            first, second = ends[0].component, ends[1].component
            if first in names and second in names:
                yield Edge(
                    between=(first, second),
                    overhead=connector.cost,
                    traffic=connector.traffic,
                )


def _exclusive(
    robot: model.Robot, chosen: list[model.Architecture]
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield exclusive devices, and of each architecture that needs one a component."""
    for device in robot.devices:
        users = [a for a in chosen if device.exclusive and needs_device(a, device.name)]
        if len({a.function for a in users}) > 1:
            yield (
                device.name,
                tuple(
                    next(c.name for c in a.components if device.name in c.devices)
                    for a in users
                ),
            )


def _time_limits(robot: model.Robot, names: set[str]) -> Iterator[TimeLimit]:
    """Yield what chains lose on wires, by their connectors' messages."""
    sizes: dict[frozenset[str], float] = {}
    for connector in robot.all_connectors():
        ends = frozenset(end.component for end in connector.between)
        sizes.setdefault(ends, connector.message)
    for chain in robot.chains:
        if names >= set(chain.through):
            yield TimeLimit(
                name=chain.name,
                limit=chain.deadline,
                hops=tuple(
                    Hop(between=pair, size=sizes.get(frozenset(pair), 0.0))
                    for pair in pairwise(chain.through)
                ),
                price=LATENESS_PRICE,
            )


def _within(
    groups: tuple[tuple[str, ...], ...], names: set[str]
) -> tuple[tuple[str, ...], ...]:
    """Return the groups without the components that the task does not need."""
    kept = (tuple(name for name in group if name in names) for group in groups)
    return tuple(group for group in kept if len(group) > 1)
