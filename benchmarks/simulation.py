"""How near `poise simulate` comes to the emulated robot, with the same placement.

    python -m benchmarks.simulation [--seconds 30] [--only two tight t-rot] [--json]
    python -m benchmarks.simulation --speed 1h

Each robot is profiled where it has no profile, run on emulated computers, and
simulated. Then one of its computers loses power, and a component is moved, in both.
Run it where computers can be emulated, on a machine with nothing else to do: what else
runs there delays the emulated robot only.

It imports internal modules: a move at a chosen moment is no part of what users ask of a
simulation.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import msgspec
from msgspec import Struct

import poise
from poise.estimate.demands import with_profile
from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    Distribution,
    Profile,
    TimerProfile,
)
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
from poise.session.profiling.stored_profiles import (
    as_when_profiled,
    read_profile,
    steady,
)
from poise.session.running_robots.running import Running
from poise.simulation.choices import Choices
from poise.simulation.faults import SimulatedFault, plan_faults
from poise.simulation.rehearsal import Rehearsal, RehearsalPlan
from poise.simulation.simulation_report import SimulationReport
from poise.units import SECONDS, parse

ROOT = Path(__file__).parents[1]
FILES = {
    "two": ROOT / "benchmarks/synthetic/two.yaml",
    "tight": ROOT / "benchmarks/synthetic/tight.yaml",
    "t-rot": ROOT / "examples/trot/robot.yaml",
}
METHODS = {"two": "round-robin", "tight": "whole-functions", "t-rot": "auto"}
LOST = {"two": "right"}
"""Robots of which one computer can run all, and the other one, which loses power."""
SEEDS = 5
"""So many simulations of what happens once."""


class Compared(Struct, frozen=True):
    """One figure of both: of the emulated robot and of the simulation.

    `most` is by how much they may differ, in the same unit; a share of the emulated
    one's where `is_ratio`.
    """

    what: str
    emulated: float
    simulated: float
    most: float
    is_ratio: bool = False

    @property
    def is_near(self) -> bool:
        """Whether they differ by no more than they may."""
        most = self.most * (self.emulated if self.is_ratio else 1.0)
        return abs(self.emulated - self.simulated) <= most


def main() -> None:
    """Compare the robots that the command line names."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.simulation", description=__doc__
    )
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--only", nargs="*", default=list(FILES), choices=list(FILES))
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--speed", help="only how long so much virtual time takes")
    asked = parser.parse_args()
    if asked.speed:
        print_speed(parse(asked.speed, SECONDS))
        return
    found = {}
    for name in asked.only:
        found[name] = compare(name, asked.seconds)
        if not asked.json:
            print_table(name, found[name])
    if asked.json:
        print(msgspec.json.format(msgspec.json.encode(found)).decode())


def print_speed(seconds: float) -> None:
    """Print how long virtual time takes, under random faults."""
    trot = poise.load(FILES["t-rot"])
    for what, robot, profile in (
        ("T-Rot, 25 components on 2 computers", trot, read_profile(trot)),
        ("200 components on 20 computers", *crowd()),
    ):
        task = robot.tasks[0].name
        faults = random_faults(robot, seconds)
        placed = poise.place(robot, task)
        plan = RehearsalPlan(
            robot=robot,
            placement=dict(placed.where),
            method="auto",
            tasks=(task,),
            profile=profile,
            faults=faults,
            seconds=seconds,
        )
        told = rehearse(plan, seconds)
        print(
            f"{what}: {seconds:g} virtual s, {len(faults)} faults, "
            f"{told.messages} messages in {told.took:.1f} s of CPU: "
            f"{told.ratio:.0f} times real time; {len(told.violations)} violations"
        )


def random_faults(robot: Robot, seconds: float) -> tuple[SimulatedFault, ...]:
    """Return about one fault every five minutes."""
    names = [computer.name for computer in robot.computers]
    return tuple(plan_faults(Choices(1), names, 0.0, seconds, mean_pause=300.0))


def crowd() -> tuple[Robot, Profile]:
    """Return a robot of 40 chains of five components, on 20 computers."""
    chains = [[f"c{k}_{i}" for i in range(5)] for k in range(40)]
    robot = Robot(
        name="crowd",
        folder="/crowd",
        computers=tuple(
            Computer(name=f"m{k}", capacity={"cpu": 1.0, "memory": 1e9})
            for k in range(20)
        ),
        architectures=tuple(
            Architecture(
                name=f"a{k}",
                function=f"f{k}",
                components=tuple(
                    ComponentEntry(
                        name=name,
                        implementation=f"crowd:{name}",
                        demand={"cpu": 0.05, "memory": 1e6},
                    )
                    for name in names
                ),
                connectors=tuple(
                    Connector(
                        between=(ConnectorEnd(one, "out"), ConnectorEnd(other, "in"))
                    )
                    for one, other in pairwise(names)
                ),
            )
            for k, names in enumerate(chains)
        ),
        tasks=(
            Task(
                name="all",
                actions=(
                    Action(name="go", functions=tuple(f"f{k}" for k in range(40))),
                ),
            ),
        ),
    )
    timer = TimerProfile(period=0.1, median=0.0, p99=0.0, maximum=0.0)
    known = ComponentProfile(
        version="1", cpu=Distribution(mean=0.04), start=0.2, timers={"tick": timer}
    )
    return robot, Profile(
        robot="crowd",
        poise="1",
        computer="m0",
        speed=1.0,
        at="",
        seconds=1.0,
        components={c.name: known for c in robot.components()},
        connectors={
            str(each): ConnectorProfile(messages=10.0, size=500.0)
            for each in robot.all_connectors()
        },
    )


def print_table(name: str, figures: list[Compared]) -> None:
    """Print the figures of one robot."""
    print(f"{name:44} {'emulated':>9} {'simulated':>9}", flush=True)
    for each in figures:
        verdict = "" if each.is_near else "  differs"
        print(f"  {each.what:42} {each.emulated:9.3f} {each.simulated:9.3f}{verdict}")


def compare(name: str, seconds: float) -> list[Compared]:
    """Return the figures of one robot."""
    robot = poise.load(FILES[name])
    profile = read_profile(robot)
    if profile is None:
        say(f"{name}: profiled")
        profile = poise.profile(robot, seconds=min(10.0, seconds)).profile
        robot = with_profile(robot, profile)
    task = robot.tasks[0].name
    placed = poise.place(robot, task, method=METHODS[name])
    say(f"{name}: emulated for {seconds:g} s")
    with steady(robot):
        ran = poise.run(
            as_when_profiled(robot), task, seconds=seconds, placement=placed
        )
    plan = RehearsalPlan(
        robot=robot,
        placement=dict(placed.where),
        method=METHODS[name],
        tasks=(task,),
        profile=profile,
        adapts=False,
        seconds=seconds,
    )
    told = rehearse(plan, seconds)
    shares = {load.computer: load.cpu for load in told.loads}
    figures = [
        Compared(f"CPU of {computer}", share, shares[computer], 0.05)
        for computer, share in ran.cpu_share.items()
    ]
    due = {(t.component, t.timer): t for t in told.timers if t.deadline is not None}
    for component in ran.components:
        for timer in component.timers:
            known = due.get((component.name, timer.name))
            if known is not None and timer.releases:
                what = f"deadlines missed by {component.name}.{timer.name}"
                missed = timer.missed / timer.releases
                figures.append(Compared(what, missed, known.share, 0.05))
    ages = {chain.name: chain.median for chain in told.chains}
    for each in ran.chains:
        if each.age.count and each.name in ages:
            what, age = f"age of {each.name}: median [s]", each.age.median
            figures.append(Compared(what, age, ages[each.name], 0.3, is_ratio=True))
    if name in LOST:
        figures += events(name, robot, plan)
    return figures


def events(name: str, robot: Robot, plan: RehearsalPlan) -> list[Compared]:
    """Return how long a fail-over takes, and a move, and the downtime of that."""
    lost = LOST[name]
    names = sorted(n for n, at in plan.placement.items() if at == lost)
    moved, target = names[0], next(c.name for c in robot.computers if c.name != lost)
    say(f"{name}: '{lost}' loses power, and '{moved}' moves")
    placed = poise.place(robot, plan.tasks[0], method=plan.method)
    with (
        poise.emulated(robot) as computers,
        poise.up(robot, placement=placed, adapt=True) as running,
    ):
        time.sleep(2.0)
        began = time.monotonic()
        downtime = running.move(moved, target, force=True).downtime
        moving = time.monotonic() - began
        running.move(moved, lost, force=True)
        time.sleep(2.0)
        began = time.monotonic()
        computers.crash(lost)
        failing = until(lambda: works_without(running, lost), began)
        computers.boot(lost)
        until(lambda: not running.status().deviations, time.monotonic())
    fault = SimulatedFault(5.0, "isolate computer", lost, lasts=15.0)
    adapting = msgspec.structs.replace(plan, faults=(fault,), adapts=True)
    outages = []
    moves = []
    for seed in range(SEEDS):
        told = rehearse(adapting, 15.0, seed)
        outages.append(max(e.at + e.lasts for e in told.outages) - fault.at)
        moves.append(rehearsed_move(plan, moved, target, seed))
    return [
        Compared("fail-over [s]", failing, mean(outages), 0.3, is_ratio=True),
        Compared("a move [s]", moving, mean([m for m, _ in moves]), 0.3, is_ratio=True),
        Compared(
            "its downtime [s]",
            downtime,
            mean([d for _, d in moves]),
            0.3,
            is_ratio=True,
        ),
    ]


def rehearse(plan: RehearsalPlan, seconds: float, seed: int = 1) -> SimulationReport:
    """Return what a simulation says."""
    rehearsal = Rehearsal(plan, seed)
    rehearsal.come_up()
    rehearsal.advance(seconds)
    report = rehearsal.report()
    rehearsal.close()
    return report


def rehearsed_move(
    plan: RehearsalPlan, component: str, target: str, seed: int
) -> tuple[float, float]:
    """Return how long a move takes, and its downtime [s]."""
    rehearsal = Rehearsal(plan, seed)
    rehearsal.come_up()
    rehearsal.advance(2.0)
    began = rehearsal.now
    report = rehearsal.move(component, target)
    took = rehearsal.now - began
    rehearsal.close()
    return took, report.downtime


def works_without(running: Running, lost: str) -> bool:
    """Return whether all components are active, none of them on a lost computer."""
    status = running.status()
    active = {
        component.name
        for name, computer in status.computers.items()
        if name != lost
        for container in computer.containers
        for component in container.components
        if component.state == "active"
    }
    return active >= status.placement.keys()


def until(holds: Callable[[], bool], began: float, limit: float = 30.0) -> float:
    """Return how long after `began` something holds [s]."""
    while not holds():
        if time.monotonic() - began > limit:
            sys.exit(f"not within {limit:g} s")
        time.sleep(0.02)
    return time.monotonic() - began


def mean(values: list[float]) -> float:
    """Return the mean."""
    return sum(values) / len(values)


def say(text: str) -> None:
    """Tell what is measured now."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
