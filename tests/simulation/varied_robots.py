"""Robots with alternatives, pins, devices and actions: another one for each seed."""

from __future__ import annotations

import random
from itertools import pairwise

from poise.model.hardware import Device
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Robot,
    Task,
)
from poise.session.placing.first_phase import first_phase
from tests.simulation.conftest import joined, small_scenario
from tests.simulation.simulated_run import EARLIER_KINDS, Scenario

COMPUTERS = "abc"
_FUNCTIONS = ("seeing", "thinking", "acting", "talking")
_ACTION = 12.0
"""An action lasts so long [s]."""


def varied_scenario(seed: int, seconds: float) -> Scenario:
    """Return the robot of a seed; of every other one standbys follow the manager.

    Nobody takes it over by force: on the other side of a cut, what an action used then
    goes on from its state of before, though it has run elsewhere meanwhile.
    """
    draw = random.Random(seed)
    architectures = tuple(
        _architecture(draw, f"{function}{number}", function)
        for function in _FUNCTIONS
        for number in range(draw.choice((1, 1, 2)))
    )
    robot = Robot(
        name="varied",
        folder="/robot",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 2.0, "memory": 1e9})
            for name in COMPUTERS
        ),
        devices=tuple(Device(name=f"eye-{c}", computer=c) for c in COMPUTERS),
        architectures=architectures,
        tasks=(_task(draw, "work", seconds), _task(draw, "beside", seconds)),
    )
    tasks = ("work", "beside") if draw.random() < 0.4 else ("work",)
    placed = first_phase(robot, tasks, None, lambda _: None).placed
    small = small_scenario(seconds, elects=seed % 2 == 1)
    return Scenario(
        robot=robot,
        placement=dict(placed.where),
        tasks=tasks,
        seconds=seconds,
        kinds=tuple(kind for kind in EARLIER_KINDS if kind != "take over"),
        election=small.election,
    )


def _architecture(draw: random.Random, name: str, function: str) -> Architecture:
    names = [f"{name}-{i}" for i in range(draw.choice((1, 1, 2, 3)))]
    return Architecture(
        name=name,
        function=function,
        priority=draw.randrange(3),
        quality=draw.choice((0.5, 0.7, 0.9)),
        components=tuple(_component(draw, name) for name in names),
        connectors=tuple(joined(f"{a}.out", f"{b}.in") for a, b in pairwise(names)),
    )


def _component(draw: random.Random, name: str) -> ComponentEntry:
    only: tuple[str, ...] = ()
    devices: tuple[str, ...] = ()
    kind = draw.random()
    if kind < 0.3:
        only = tuple(draw.sample(COMPUTERS, 2))
    elif kind < 0.4:
        only = tuple(draw.sample(COMPUTERS, 1))
    elif kind < 0.5:
        devices = (f"eye-{draw.choice(COMPUTERS)}",)
    return ComponentEntry(
        name=name,
        implementation=f"varied:{name}",
        demand={"cpu": draw.choice((0.1, 0.2, 0.3)), "memory": 1e6},
        only=only,
        devices=devices,
    )


def _task(draw: random.Random, name: str, seconds: float) -> Task:
    """Return a task of actions that follow each other, each as the one before ends."""
    used = [
        tuple(draw.sample(_FUNCTIONS, draw.randrange(1, len(_FUNCTIONS) + 1)))
        for _ in range(int(seconds / _ACTION) + 1)
    ]
    step = Action(name=f"{name}-{len(used)}", functions=used[0])
    for number, functions in reversed(list(enumerate(used))):
        step = Action(
            name=f"{name}-{number}", functions=functions, limit=_ACTION, on_failure=step
        )
    every = sorted({function for functions in used for function in functions})
    needs = tuple(draw.sample(every, 1)) if draw.random() < 0.3 else ()
    return Task(name=name, actions=(step,), needs=needs, priority=draw.randrange(2))
