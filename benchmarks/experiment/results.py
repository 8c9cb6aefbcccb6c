"""What is compared, under which conditions, and in which order. Pure.

It imports internal modules: it changes the robot that runs.
"""

from __future__ import annotations

import os
import random
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import Struct
from msgspec.structs import replace

import poise
from poise.errors import UsageError
from poise.model.robot import ComponentEntry, Robot

BASE = "as in the robot file"


class Arm(Struct, frozen=True, kw_only=True):
    """A way to place components.

    Parameters
    ----------
    method
        What places them (`poise.place`); ``{seed}`` is another one in each run.
    alike
        Whether all functions have one priority: no CPU weight, no nice value.
    adapts
        Whether Poise changes the placement while the robot runs.
    """

    name: str
    method: str
    what: str
    alike: bool = False
    adapts: bool = False


ARMS = (
    Arm(
        name="static",
        method="static",
        alike=True,
        what="every function on its home computer, all of one priority",
    ),
    Arm(
        name="static, nice",
        method="static",
        what="the same with the CPU weights and nice values of the functions' "
        "priorities, which all other arms have, too",
    ),
    Arm(name="random", method="random:{seed}", what="another placement in each run"),
    Arm(name="round robin", method="round-robin", what="components in turn"),
    Arm(
        name="whole functions",
        method="whole-functions",
        what="by hand: each function on one computer, but for its devices; the "
        "largest first, where most CPU is left",
    ),
    Arm(
        name="least loaded",
        method="least-loaded",
        what="one component after the other on the computer with the least load, as "
        "YARP's manager does",
    ),
    Arm(
        name="least allocated",
        method="least-allocated",
        what="one component after the other by requests of CPU and memory, as "
        "Kubernetes' scheduler does",
    ),
    Arm(name="greedy", method="greedy", what="the paper's algorithm"),
    Arm(name="Poise", method="auto", what="placed once, without adaptation"),
    Arm(
        name="Poise, adapts",
        method="auto",
        adapts=True,
        what="placed so, and again while it runs when deadlines are missed",
    ),
)
QUICK = ("static", "random", "greedy", "Poise")
USUAL = (
    *("static, nice", "random", "whole functions", "least allocated", "greedy"),
    *("Poise", "Poise, adapts"),
)


class TrialCondition(Struct, frozen=True, kw_only=True):
    """Under what the robot runs.

    Parameters
    ----------
    load
        How many times slower its computers are: all loads grow so, in proportion.
    bandwidth
        Of each link [bytes/s]; 0: as in the robot file.
    fill
        The share of the CPU that the components need in all; 0: as the load makes it.
    parameters
        Component -> parameters that it runs with, though its demand is of others.
    programs
        Other programs: when each begins, as a share of the run, its computer, and the
        share of the computer's CPU that it takes. Nothing tells the planner.
    """

    name: str
    load: float = 1.0
    fill: float = 0.0
    bandwidth: float = 0.0
    parameters: Mapping[str, Mapping[str, Any]] = {}
    programs: tuple[tuple[float, str, float], ...] = ()


LOADS = tuple(
    TrialCondition(name=f"load of {share} %", load=share / 100)
    for share in (60, 80, 120, 140)
)


class Trial(Struct, frozen=True):
    """One run that is to be made, by the names of its arm and condition."""

    arm: str
    condition: str
    seed: int


class Extent(Struct, frozen=True, kw_only=True):
    """How much is tried.

    Parameters
    ----------
    base_seeds, seeds
        Runs of each arm in the first condition, and in each other one.
    """

    conditions: tuple[TrialCondition, ...]
    arms: tuple[Arm, ...] = ARMS
    base_seeds: int = 12
    seeds: int = 12


def extents(conditions: tuple[TrialCondition, ...]) -> dict[str, Extent]:
    """Return the extents to choose from: one, quick, usual, full.

    The usual one has the first three conditions, and as few ways and as many runs as it
    takes that the test, adjusted for all comparisons, can reach its level.
    """
    arms = tuple(named(ARMS, name) for name in QUICK)
    quick = Extent(arms=arms, conditions=conditions[:1], base_seeds=2)
    usual = tuple(named(ARMS, name) for name in USUAL)
    return {
        "one": replace(quick, arms=arms[:1], base_seeds=1),
        "quick": quick,
        "usual": Extent(arms=usual, conditions=conditions[:3]),
        "full": Extent(conditions=conditions, base_seeds=79, seeds=20),
    }


def schedule(extent: Extent) -> list[Trial]:
    """Return all trials, in an order that is always the same.

    Of each seed come all conditions, in each all arms in an order of its own: what else
    this machine does hits all alike, and an experiment that is ended early has as many
    runs of each arm.
    """
    chance = random.Random(0)
    trials = []
    for seed in range(max(extent.base_seeds, extent.seeds)):
        for number, condition in enumerate(extent.conditions):
            if seed < (extent.seeds if number else extent.base_seeds):
                arms = chance.sample(extent.arms, len(extent.arms))
                trials += [Trial(arm.name, condition.name, seed) for arm in arms]
    return trials


N = TypeVar("N", Arm, TrialCondition)


def named(things: Sequence[N], name: str) -> N:
    """Return the thing of this name."""
    return next(each for each in things if each.name == name)


def under(robot: Robot, condition: TrialCondition, task: str) -> Robot:
    """Return the robot as it is known under a condition, to be placed."""
    load = condition.fill / needed(robot, task) if condition.fill else condition.load
    links = tuple(
        replace(link, bandwidth=condition.bandwidth) if condition.bandwidth else link
        for link in robot.links
    )
    computers = tuple(
        replace(computer, speed=computer.speed / load) for computer in robot.computers
    )
    return replace(robot, links=links, computers=computers)


def needed(robot: Robot, task: str) -> float:
    """Return the share of all usable CPU that a task's components need, by Poise."""
    placed = poise.place(robot, task)
    problem = placed.result.problem
    usable = sum(
        each.capacity["cpu"] * each.speed * (1 - each.reserve.get("cpu", 0.0))
        for each in problem.computers
    )
    items = (each for each in problem.components if each.name in placed.where)
    return sum(each.demand.get("cpu", 0.0) for each in items) / usable


def as_it_runs(robot: Robot, arm: Arm, condition: TrialCondition, seed: int) -> Robot:
    """Return the robot that runs once it is placed, in the world of this seed."""

    def change(component: ComponentEntry) -> ComponentEntry:
        more = condition.parameters.get(component.name, {})
        return replace(component, parameters={**component.parameters, **more})

    changed = robot.with_components(change)
    if arm.alike:
        alike = (replace(each, priority=0) for each in changed.architectures)
        changed = replace(changed, architectures=tuple(alike))
    if changed.simulator is not None:
        words = (*changed.simulator.command, "--endless", "--seed", str(seed))
        world = replace(changed.simulator, command=words)
        changed = replace(changed, simulator=world)
    return changed


class Missed(Struct, frozen=True, kw_only=True):
    """How often a timer was due or a chain's data was used, and how often too late.

    A chain with `of` 0 was declared, and its data never arrived.

    Of a chain `median` and `p99` are ages of its data when it was used [s].
    """

    of: int
    missed: int
    median: float | None = None
    p99: float | None = None


class TrialResult(Struct, frozen=True, kw_only=True):
    """What one run showed.

    Parameters
    ----------
    at
        When it began [s since 1970].
    invalid
        Why it says nothing about the robot; empty: it does.
    seconds
        How long it was measured [s].
    placement
        Component -> computer, at the start.
    decision_seconds
        How long that took to decide [s].
    suspended
        Architectures that did not run, because not all fits.
    functions
        Function -> whether it worked, as the simulated world saw it.
    world
        The world's other results.
    chains, timers
        How each kept its deadline.
    cpu_share
        Computer -> CPU used, as a share of what it has.
    moves
        How many components moved while it ran.
    world_waited
        How long the simulated world was ready to run and got no CPU [s].
    host_load
        Load average of this machine when it began.
    speeds
        What this machine did before and after [loops/s of CPU time].
    stolen
        The share of this machine's CPU time that a hypervisor took.
    """

    trial: Trial
    at: float
    invalid: str = ""
    seconds: float = 0.0
    placement: Mapping[str, str] = {}
    decision_seconds: float = 0.0
    suspended: tuple[str, ...] = ()
    functions: Mapping[str, bool] = {}
    world: Mapping[str, Any] = {}
    chains: Mapping[str, Missed] = {}
    timers: Mapping[str, Missed] = {}
    cpu_share: Mapping[str, float] = {}
    moves: int = 0
    world_waited: float = 0.0
    host_load: float = 0.0
    speeds: tuple[float, ...] = ()
    stolen: float = 0.0


def append(file: Path, result: TrialResult) -> None:
    """Add a result; it is on the disk when this returns."""
    with file.open("ab") as out:
        out.write(msgspec.json.encode(result) + b"\n")
        out.flush()
        os.fsync(out.fileno())


def read(file: Path) -> list[TrialResult]:
    """Return the results in a file; none where there is no file.

    A last line that was cut off, as by a loss of power, is taken out of the file.

    Raises
    ------
    UsageError
        Another line is no result.
    """
    if not file.exists():
        return []
    lines = file.read_bytes().splitlines(keepends=True)
    if lines and not lines[-1].endswith(b"\n"):
        os.truncate(file, sum(map(len, lines[:-1])))
        lines = lines[:-1]
    found = []
    for number, line in enumerate(lines, 1):
        try:
            found.append(msgspec.json.decode(line, type=TrialResult))
        except msgspec.DecodeError as error:
            raise UsageError(
                f"{file}, line {number} is no result ({error}): remove it, or give "
                "another folder with --folder"
            ) from error
    return found


def remaining(trials: Iterable[Trial], results: Iterable[TrialResult]) -> list[Trial]:
    """Return the trials without a valid result: invalid runs are made again."""
    done = {each.trial for each in results if not each.invalid}
    return [trial for trial in trials if trial not in done]
