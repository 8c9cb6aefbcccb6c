"""What is compared, under which conditions, and in which order. Pure."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from poise.model.robot import ComponentEntry, Robot

BASE = "as in the robot file"
SLOW_LINK = "link of 10 Mbit/s"
OVERRUN = "the localiser overruns by half"
_SLOW = 10e6 / 8
"""[bytes/s]"""


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


class TrialCondition(Struct, frozen=True, kw_only=True):
    """Under what the robot runs.

    Parameters
    ----------
    load
        How many times slower its computers are: all loads grow so, in proportion.
    bandwidth
        Of each link [bytes/s]; 0: as in the robot file.
    parameters
        Component -> parameters that it runs with, though its demand is of others.
    """

    name: str
    load: float = 1.0
    bandwidth: float = 0.0
    parameters: Mapping[str, Mapping[str, Any]] = {}


LOADS = tuple(
    TrialCondition(name=f"load of {share} %", load=share / 100)
    for share in (60, 80, 120, 140, 160)
)
CONDITIONS = (
    TrialCondition(name=BASE),
    *LOADS,
    TrialCondition(name=SLOW_LINK, bandwidth=_SLOW),
    TrialCondition(name=OVERRUN, parameters={"localiser": {"particles": 3000}}),
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

    arms: tuple[Arm, ...] = ARMS
    conditions: tuple[TrialCondition, ...] = CONDITIONS
    base_seeds: int = 10
    seeds: int = 3


USUAL = Extent()
FULL = Extent(base_seeds=79, seeds=10)
SHORT = Extent(
    arms=tuple(arm for arm in ARMS if arm.name in QUICK),
    conditions=CONDITIONS[:1],
    base_seeds=2,
)


def schedule(extent: Extent) -> list[Trial]:
    """Return all trials, in an order that is always the same.

    Of each seed come all conditions, in each all arms in an order of its own: what else
    this machine does hits all alike, and an experiment that is ended early has as many
    runs of each arm.
    """
    chance = random.Random(0)  # noqa: S311 - nothing secret
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


def under(robot: Robot, condition: TrialCondition) -> Robot:
    """Return the robot as it is known under a condition, to be placed."""
    links = tuple(
        replace(link, bandwidth=condition.bandwidth) if condition.bandwidth else link
        for link in robot.links
    )
    computers = tuple(
        replace(computer, speed=computer.speed / condition.load)
        for computer in robot.computers
    )
    return replace(robot, links=links, computers=computers)


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
