"""What the loop of adaptation costs: CPU of manager and agent, and time to decide.

It imports internal modules: it times single decisions, on situation that it makes up.
"""

from __future__ import annotations

import random
import sys
import time
from statistics import median

from msgspec.structs import replace

import poise
from benchmarks.synthetic import robots
from poise import plan
from poise.estimate.online import Estimate
from poise.manage.adaptation.decision import decide
from poise.manage.adaptation.situation import Situation
from poise.manage.observe.estimates import DemandEstimate, Load
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
from poise.wire.records.status_records import AgentStatus

SETTLE = 5.0
COMPONENTS, COMPUTERS, TOGETHER = 100, 4, 5


def cpu(seconds: float) -> dict[str, float]:
    """Return the CPU use of manager and agent with 24 components [cores]."""
    sys.path.insert(0, robots.FOLDER)
    robot = robots.together(0.5)
    functions = tuple(a.function for a in robot.architectures)
    action = Action(name="work", functions=functions)
    robot = replace(robot, tasks=(Task(name="work", actions=(action,)),))
    found = {}
    for adapt in (True, False):
        placed = poise.place(robot, method="greedy")
        with poise.up(robot, placement=placed, adapt=adapt) as running:
            time.sleep(SETTLE)
            before, manager = running.status(), time.process_time()
            began = time.monotonic()
            time.sleep(seconds)
            used, lasted = time.process_time() - manager, time.monotonic() - began
            after = running.status()
        name = "manager" if adapt else "manager that only reports"
        found[f"{name} [cores]"] = used / lasted
        if adapt:
            (first,), (last,) = before.computers.values(), after.computers.values()
            agent = _own(last) - _own(first)
            found["agent [cores]"] = agent / (last.uptime - first.uptime)
    return found


def decision(times: int) -> dict[str, float]:
    """Return how long decisions take for 100 components on 4 computers [s]."""
    took, acted = [], 0
    for seed in range(times):
        situation = _overloaded(seed)
        began = time.perf_counter()
        found = decide(situation)
        took.append(time.perf_counter() - began)
        acted += found.acts
    return {
        "decision, median [s]": median(took),
        "decision, longest [s]": max(took),
        "decisions that moved components, of all": acted / times,
    }


def _own(status: AgentStatus) -> float:
    """Return the CPU time of an agent and of what it keeps for containers [s]."""
    return status.cpu - sum(c.cpu for c in status.containers)


def _overloaded(seed: int) -> Situation:
    """Return a robot at 60 % of its CPU, and a program that takes half a computer."""
    robot = _large(seed)
    found = plan.solve(plan.problem_of(robot, "work"), budget=0.2)
    capacity = robot.computers[0].capacity["cpu"]
    busy = robot.computers[0].name
    loads = {
        c.name: Load(
            capacity=capacity,
            used=capacity if c.name == busy else 0.6 * capacity,
            background=0.5 * capacity if c.name == busy else 0.0,
        )
        for c in robot.computers
    }
    estimates = tuple(
        DemandEstimate(
            component=c.name,
            computer=found.placement[c.name],
            expected=None,
            estimate=Estimate(mean=c.demand["cpu"], p95=c.demand["cpu"], error=0.001),
        )
        for c in robot.components()
    )
    return Situation(
        robot=robot,
        placement=dict(found.placement),
        loads=loads,
        demand_estimates=estimates,
    )


def _large(seed: int) -> Robot:
    chance = random.Random(seed)
    components = [
        ComponentEntry(
            name=f"c{i}", demand={"cpu": chance.uniform(0.01, 0.06), "memory": 1e6}
        )
        for i in range(COMPONENTS)
    ]
    architectures = tuple(
        Architecture(
            name=f"a{start}",
            function=f"a{start}",
            components=tuple(components[start : start + TOGETHER]),
            connectors=tuple(
                _connector(components[i], components[i + 1], chance)
                for i in range(start, start + TOGETHER - 1)
            ),
        )
        for start in range(0, COMPONENTS, TOGETHER)
    )
    cores = sum(c.demand["cpu"] for c in components) / 0.6 / COMPUTERS
    computer = Computer(name="h", capacity={"cpu": cores, "memory": 1e9})
    return Robot(
        name="large",
        computers=tuple(replace(computer, name=f"h{i}") for i in range(COMPUTERS)),
        architectures=architectures,
        tasks=(
            Task(
                name="work",
                actions=(
                    Action(
                        name="work", functions=tuple(a.function for a in architectures)
                    ),
                ),
            ),
        ),
    )


def _connector(
    one: ComponentEntry, two: ComponentEntry, chance: random.Random
) -> Connector:
    return Connector(
        between=(ConnectorEnd(one.name, "out"), ConnectorEnd(two.name, "in")),
        overhead=chance.uniform(0.1, 1.0),
    )
