"""Robots on which all is tight, slow or fails: another one for each seed.

Beside what `varied_robots` has: more computers, slow links, little memory and CPU, code
that needs more than was said, code that fails, policies of their own, and tasks whose
steps repeat, are chosen, run at once, or end as components say so.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise, product

from msgspec.structs import replace

from poise.errors import RobotError
from poise.model.hardware import Device, Link
from poise.model.loading import check
from poise.model.policy import Policy
from poise.model.repository import Repository
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Robot,
    Task,
)
from poise.model.steps import Choice, Parallel, Repeat, Retry, Step, Subtask, Until
from poise.model.steps import Sequence as Steps
from poise.runtime.component.ports import Timer
from poise.session.placing.first_phase import first_phase
from poise.simulation.component_models import ComponentModel, HandlerModel, TimerModel
from poise.simulation.workload import SimulatedWork
from poise.wire.records.request_records import Election
from tests.simulation.clients import FLAWS
from tests.simulation.conftest import joined
from tests.simulation.simulated_run import EARLIER_KINDS, Scenario

_FUNCTIONS = ("seeing", "thinking", "acting", "talking")
_TASKS = ("work", "beside", "later")
_MB = 1e6
_POLICIES = (
    Policy(
        name="away", for_each="component", when="cpu > 10%", lasts=2.0, do="move",
        cool_down=10.0,
    ),
    Policy(
        name="again", for_each="component", when="starved > 5%", lasts=2.0,
        do="restart", cool_down=15.0,
    ),
    Policy(
        name="lesser", for_each="timer", when="share > 5%", lasts=1.0, do="replace",
        cool_down=10.0,
    ),
    Policy(
        name="less", for_each="computer", when="used > 60%", lasts=2.0, do="suspend",
        cool_down=20.0,
    ),
    Policy(
        name="better", for_each="robot", when="used > 50%", lasts=3.0, do="replan",
        cool_down=10.0,
    ),
    Policy(name="deadlines", off=True),
    Policy(name="overload", off=True),
)  # fmt: skip


def wild_scenario(seed: int, seconds: float) -> Scenario:
    """Return the robot of a seed; of every other one standbys follow the manager."""
    draw = random.Random(f"wild {seed}")
    while (scenario := _scenario(draw, seed, seconds)) is None:
        pass  # what was drawn fits nowhere
    return scenario


def _scenario(draw: random.Random, seed: int, seconds: float) -> Scenario | None:
    computers = _computers(draw)
    names = [computer.name for computer in computers]
    architectures = tuple(
        _architecture(draw, f"{function}{number}", function, names)
        for function in _FUNCTIONS
        for number in range(draw.choice((1, 1, 2, 3)))
    )
    robot = Robot(
        name="wild",
        folder="/robot",
        computers=computers,
        links=_links(draw, names),
        devices=tuple(Device(name=f"eye-{name}", computer=name) for name in names),
        architectures=architectures,
        connectors=_between(draw, architectures),
        tasks=_tasks(draw, architectures),
        policies=_policies(draw, names),
        explore=draw.random() < 0.2,
    )
    wrong = list(check(robot, Repository()))
    tasks = _TASKS[: draw.choice((1, 1, 2, 3))]
    if wrong:
        return None
    try:
        placed = first_phase(robot, tasks, None, lambda _: None).placed
    except RobotError:
        return None
    election = Election(votes=dict.fromkeys(names, 1), managers=tuple(names))
    return Scenario(
        robot=robot,
        placement=dict(placed.where),
        tasks=tasks,
        seconds=seconds,
        workload=_workload(draw, robot),
        kinds=tuple(kind for kind in EARLIER_KINDS if kind != "take over"),
        election=election if seed % 2 == 1 else None,
        is_wild=True,
    )


def _computers(draw: random.Random) -> tuple[Computer, ...]:
    cores = draw.choice((0.6, 1.0, 2.0))
    memory = draw.choice((60, 150, 1000))
    return tuple(
        Computer(
            name=name,
            capacity={
                "cpu": cores * draw.choice((0.7, 1.0)),
                "memory": memory * _MB * draw.choice((0.7, 1.0)),
            },
            speed=draw.choice((1.0, 1.0, 0.7, 1.5)),
        )
        for name in "abcdef"[: draw.choice((2, 3, 3, 4, 5, 6))]
    )


def _links(draw: random.Random, names: Sequence[str]) -> tuple[Link, ...]:
    if draw.random() < 0.5:
        return ()
    one, other = draw.sample(names, 2)
    return (
        Link(
            between=(one, other),
            latency=draw.choice((0.0, 0.01, 0.04)),
            bandwidth=draw.choice((1e5, 1e6, 1e7)),
        ),
    )


def _architecture(
    draw: random.Random, name: str, function: str, computers: Sequence[str]
) -> Architecture:
    names = [f"{name}-{i}" for i in range(draw.choice((1, 1, 2, 3)))]

    return Architecture(
        name=name,
        function=function,
        priority=draw.randrange(3),
        quality=draw.choice((0.5, 0.7, 0.9)),
        linger=draw.choice((None, 0.0, 3.0, 20.0)),
        exclusive=draw.random() < 0.1,
        components=tuple(_component(draw, name, computers) for name in names),
        connectors=tuple(joined(f"{a}.out", f"{b}.in") for a, b in pairwise(names)),
    )


def _component(
    draw: random.Random, name: str, computers: Sequence[str]
) -> ComponentEntry:
    only: tuple[str, ...] = ()
    devices: tuple[str, ...] = ()
    kind = draw.random()
    if kind < 0.2:
        only = tuple(draw.sample(computers, 2))
    elif kind < 0.3:
        only = tuple(draw.sample(computers, 1))
    elif kind < 0.4:
        devices = (f"eye-{draw.choice(computers)}",)
    return ComponentEntry(
        name=name,
        implementation=f"varied:{name}",
        demand={
            "cpu": draw.choice((0.05, 0.1, 0.2, 0.3)),
            "memory": draw.choice((5, 10, 30)) * _MB,
        },
        only=only,
        devices=devices,
        movable=draw.random() < 0.93,
        isolated=draw.random() < 0.2,
        checkpoint=draw.choice((0.0, 0.0, 1.0)),
    )


def _between(
    draw: random.Random, architectures: Sequence[Architecture]
) -> tuple[Connector, ...]:
    """Return connectors from some functions to the next, for all alternatives."""
    connectors = []
    for source, target in pairwise(_FUNCTIONS):
        if draw.random() < 0.5:
            ends = (
                [a for a in architectures if a.function == function]
                for function in (source, target)
            )
            for one, other in product(*ends):
                last, first = one.components[-1].name, other.components[0].name
                connectors.append(joined(f"{last}.out", f"{first}.in"))
    return tuple(connectors)


def _policies(draw: random.Random, computers: Sequence[str]) -> tuple[Policy, ...]:
    chosen = draw.sample(_POLICIES, draw.choice((0, 0, 1, 2, 3)))
    policies = []
    for policy in chosen:
        if policy.do == "move":
            to, force = draw.choice(computers), draw.random() < 0.3
            policies.append(replace(policy, to=to, force=force))
        else:
            policies.append(policy)
    return tuple(policies)


def _tasks(
    draw: random.Random, architectures: Sequence[Architecture]
) -> tuple[Task, ...]:
    tasks: list[Task] = []
    for name in _TASKS:
        steps = _Steps(draw, architectures, [task.name for task in tasks])
        actions = tuple(steps.some(2) for _ in range(draw.choice((2, 3, 4))))
        # so that it never ends, unless an action fails for good
        kind = Repeat if draw.random() < 0.9 else Steps
        whole: Step = kind(steps=actions)
        used = sorted(steps.used)
        needs = tuple(draw.sample(used, 1)) if used and draw.random() < 0.3 else ()
        tasks.append(
            Task(name=name, actions=(whole,), needs=needs, priority=draw.randrange(2))
        )
    return tuple(tasks)


class _Steps:
    """Draws steps of a task; `used`: the functions of its actions."""

    def __init__(
        self,
        draw: random.Random,
        architectures: Sequence[Architecture],
        others: Sequence[str],
    ) -> None:
        self._draw = draw
        self._architectures = architectures
        self._count = Counter(a.function for a in architectures)
        self._others = others
        self._number = 0
        self.used: set[str] = set()

    def some(self, depth: int) -> Step:
        draw, kind = self._draw, self._draw.random()
        if depth == 0 or kind < 0.5:
            return self._action(depth)
        if kind < 0.6 and self._others:
            return Subtask(task=draw.choice(self._others))
        inside = tuple(self.some(depth - 1) for _ in range(2))
        if kind < 0.75:
            return Parallel(steps=inside)
        if kind < 0.85:
            return Choice(steps=inside)
        if kind < 0.95:
            return Repeat(steps=inside, times=2)
        return Steps(steps=inside)

    def _action(self, depth: int) -> Action:
        draw = self._draw
        self._number += 1
        name = f"act-{self._number}"
        functions = tuple(draw.sample(_FUNCTIONS, draw.choice((1, 1, 2, 3))))
        self.used |= set(functions)
        ends = None
        if draw.random() < 0.3:
            alone = [f for f in functions if self._count[f] == 1]
            able = [
                c.name
                for a in self._architectures
                if a.function in alone
                for c in a.components
            ]
            ends = ConnectorEnd(draw.choice(able), "over") if able else None
        until = Until(when="used > 20%") if draw.random() < 0.1 else None
        fails = draw.random()
        failing: object = Retry(times=2)
        if fails < 0.8:
            failing = Retry(times=1000)
        elif fails < 0.95 and depth:
            failing = self.some(depth - 1)
        return Action(
            name=name,
            functions=functions,
            ends=ends,
            until=until,
            limit=draw.choice((0.5, 3.0, 8.0, 15.0)),
            on_failure=failing,  # type: ignore[arg-type]
        )


def _workload(draw: random.Random, robot: Robot) -> SimulatedWork:
    """Return what components do: near what was said, for some far more at times."""
    state = draw.choice((1e3, 1e5, 1e6))
    return SimulatedWork(
        models={
            component.name: _model(draw, component, state)
            for component in robot.components()
        },
        flaws=FLAWS,
    )


def _model(
    draw: random.Random, component: ComponentEntry, state: float
) -> ComponentModel:
    share = draw.choice((0.2, 0.5, 0.8))
    factors: tuple[float, ...] = ()
    if draw.random() < 0.2:
        high, calm = draw.choice((2.0, 5.0)), draw.randrange(3, 20)
        factors = (*(1.0 for _ in range(calm)), *(high for _ in range(10)))
    work = component.demand["cpu"] * share / 10 / 2
    has_deadline = draw.random() < 0.5
    tick = TimerModel(
        timer=Timer("tick", 0.1, 0.1 if has_deadline else None),
        handler=HandlerModel(work=work, spread=0.5, publishes=None),
    )
    return ComponentModel(
        timers=(tick,),
        other=HandlerModel(work=work / 2, spread=0.5),
        factors=factors,
        state_size=state * draw.random(),
        memory=component.demand["memory"] * draw.choice((0.7, 1.0, 1.0, 1.3)),
        activate=draw.choice((0.01, 0.01, 0.3)),
        start=draw.choice(((0.02, 0.2), (0.02, 0.2), (1.0, 3.0))),
        ends=("over",),
    )
