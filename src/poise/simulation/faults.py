"""Faults of a simulated robot: which a seed picks, and how each is injected and ends.

As a swarm: each seed allows a random subset of the kinds, with random weights, so that
some runs have many of one kind and none of another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import log
from typing import TYPE_CHECKING, Literal

from msgspec import Struct

if TYPE_CHECKING:  # they need greenlet, which is an extra; a fault is named without it
    from poise.simulation.choices import Choices
    from poise.simulation.robot.simulated_process import Process
    from poise.simulation.robot.simulated_robot import SimulatedRobot

SimulatedFaultKind = Literal[
    "kill agent",
    "kill container",
    "kill manager",
    "pause agent",
    "pause container",
    "pause manager",
    "pause computer",
    "suspend computer",
    "cut link",
    "cut one way",
    "isolate computer",
    "clog link",
    "lose datagrams",
    "step wall clock",
    "slow disk",
    "full disk",
    "another manager",
    "take over",
    "restart computer",
]
KINDS: tuple[SimulatedFaultKind, ...] = SimulatedFaultKind.__args__  # type: ignore[attr-defined]
LINK_KINDS: tuple[SimulatedFaultKind, ...] = ("cut link", "cut one way", "clog link")
"""Those that happen between two computers."""
ANYWHERE: tuple[SimulatedFaultKind, ...] = ("lose datagrams",)
"""These are about no computer of their own."""
TIMELESS: tuple[SimulatedFaultKind, ...] = (
    "kill container",
    "step wall clock",
    "another manager",
    "take over",
)
"""These are over at once: `lasts` says nothing about them."""
_ALLOWED = 0.4
"""Each kind is allowed in this share of runs."""
_MEAN_PAUSE = 4.0
_LONGEST = 8.0
_LONGEST_STEP = 2e8
"""A wall clock steps by up to half of that [s]: three years."""


class SimulatedFault(Struct, frozen=True):
    """Something that breaks at a moment [s], and is whole again `lasts` [s] later.

    Parameters
    ----------
    target, other
        Computers; `other` for links. What is killed is started again when it is over.
    pick
        Picks one of several containers, in [0, 1).
    """

    at: float
    kind: SimulatedFaultKind
    target: str
    other: str = ""
    lasts: float = 1.0
    pick: float = 0.0

    def __str__(self) -> str:
        where = f"{self.target}-{self.other}" if self.other else self.target
        where = "everywhere" if self.kind in ANYWHERE else where
        lasts = "" if self.kind in TIMELESS else f" for {self.lasts:.2f} s"
        return f"{self.at:.2f} s: {self.kind} {where}{lasts}"


def plan_faults(
    choices: Choices,
    computers: Sequence[str],
    begin: float,
    end: float,
    kinds: Sequence[SimulatedFaultKind] = KINDS,
    *,
    mean_pause: float = _MEAN_PAUSE,
) -> list[SimulatedFault]:
    """Return the faults of a run, all over before `end` [s]."""
    allowed = [kind for kind in kinds if choices.happens("faults", _ALLOWED)]
    allowed = allowed or [kinds[choices.among("faults", len(kinds))]]
    weights = [choices.draw("faults") for _ in allowed]
    faults: list[SimulatedFault] = []
    now = begin
    while True:
        now += -mean_pause * log(1 - choices.draw("faults"))
        lasts = _LONGEST * choices.draw("faults") ** 2
        if now + lasts >= end:
            return faults
        target = choices.among("faults", len(computers))
        step = 1 + choices.among("faults", max(1, len(computers) - 1))
        kind = _weighted(choices.draw("faults"), allowed, weights)
        other = computers[(target + step) % len(computers)]
        faults.append(
            SimulatedFault(
                at=now,
                kind=kind,
                target=computers[target],
                other=other if kind in LINK_KINDS else "",
                lasts=lasts,
                pick=choices.draw("faults"),
            )
        )


def inject(robot: SimulatedRobot, fault: SimulatedFault) -> None:
    """Let a fault begin now, and end in time."""
    robot.note("fault", str(fault))
    mend = _begin(robot, fault)
    robot.scheduler.at(robot.scheduler.now + fault.lasts, mend)


Mend = Callable[[], object]


def _begin(robot: SimulatedRobot, fault: SimulatedFault) -> Mend:
    """Break something; return what makes it whole."""
    by_verb = {
        "kill": _kill,
        "pause": _pause,
        "cut": _cut,
        "isolate": _cut,
        "restart": _restart,
    }
    begin = by_verb.get(fault.kind.partition(" ")[0])
    if begin is not None:
        return begin(robot, fault)
    network = robot.network
    match fault.kind:
        case "lose datagrams":
            lost = 0.1 + 0.6 * fault.pick
            network.loss += lost
            return lambda: setattr(network, "loss", network.loss - lost)
        case "slow disk":
            disk = robot.disks[fault.target]
            disk.delay += fault.lasts
            return lambda: setattr(disk, "delay", disk.delay - fault.lasts)
        case "full disk":
            disk = robot.disks[fault.target]
            disk.num_full += 1
            return lambda: setattr(disk, "num_full", disk.num_full - 1)
        case "suspend computer":
            robot.computers[fault.target].suspend(fault.lasts)
        case "clog link":
            network.engine.clog(fault.target, fault.other, fault.lasts)
        case "step wall clock":
            step = (fault.pick - 0.5) * _LONGEST_STEP
            robot.computers[fault.target].wall_ahead += step
        case "another manager" | "take over":  # though another may be at work
            if robot.computers[fault.target].is_off:
                return _nothing
            takes_over = fault.kind == "take over" and robot.is_reached()
            robot.start_manager(fault.target, take_over=takes_over)
    return _nothing


def _nothing() -> None:
    """Mend nothing: it ends by itself, or stays."""


def _kill(robot: SimulatedRobot, fault: SimulatedFault) -> Mend:
    agent, manager = robot.agents.get(fault.target), robot.manager
    mend: Mend
    if fault.kind == "kill agent":
        killed = [agent.process] if agent else []
        mend = robot.hold_agent(fault.target)
    elif fault.kind == "kill manager":
        killed = [manager.process] if manager else []
        mend = partial(robot.keep_managed, fault.target)
    else:
        killed, mend = _containers(robot, fault), _nothing
    for process in killed:
        process.kill()
    return mend


def _containers(robot: SimulatedRobot, fault: SimulatedFault) -> list[Process]:
    """Return the process of the picked container of a computer, if it has any."""
    computer = robot.computers[fault.target]
    here = [container.process for container in robot.containers_on(computer)]
    return here[int(fault.pick * len(here)) :][:1]


def _paused_by(robot: SimulatedRobot, fault: SimulatedFault) -> list[Process]:
    manager, agent = robot.manager, robot.agents.get(fault.target)
    match fault.kind:
        case "pause agent":
            return [agent.process] if agent else []
        case "pause manager":
            return [manager.process] if manager else []
        case "pause computer":
            return list(robot.computers[fault.target].processes.values())
    return _containers(robot, fault)


def _pause(robot: SimulatedRobot, fault: SimulatedFault) -> Mend:
    standing = _paused_by(robot, fault)
    computer = robot.computers[fault.target]
    for process in standing:
        process.pause()
    if fault.kind == "pause computer":
        computer.pauses.append(standing)
    if fault.kind == "pause manager" and robot.manager is not None:
        robot.on_moment("paused", robot.manager.process.computer.name)

    def resume() -> None:
        computer.pauses = [each for each in computer.pauses if each is not standing]
        for process in standing:
            process.resume()

    return resume


def _cut(robot: SimulatedRobot, fault: SimulatedFault) -> Mend:
    ways = [(fault.target, fault.other)]
    if not fault.other:
        ways = [(fault.target, other) for other in robot.others_than(fault.target)]
    if fault.kind != "cut one way":
        ways += [(there, here) for here, there in ways]
    for way in ways:
        robot.network.cut(*way)

    def heal() -> None:
        for way in ways:
            robot.network.heal(*way)

    return heal


def _restart(robot: SimulatedRobot, fault: SimulatedFault) -> Mend:
    """Take a computer's power: all that it knew is lost."""
    heal, manager = _cut(robot, fault), robot.manager
    computer = robot.computers[fault.target]
    was_managed_here = manager is not None and manager.process.computer is computer
    computer.lose_power()
    robot.disks[fault.target].restart()
    start_agent = robot.hold_agent(fault.target)

    def start() -> None:
        heal()
        computer.get_power()
        start_agent()
        if was_managed_here:
            robot.keep_managed(fault.target)

    return start


def _weighted(
    draw: float, kinds: Sequence[SimulatedFaultKind], weights: Sequence[float]
) -> SimulatedFaultKind:
    """Return one of the kinds, as often as its weight says."""
    left = draw * sum(weights)
    for kind, weight in zip(kinds, weights, strict=True):
        left -= weight
        if left < 0:
            return kind
    return kinds[-1]
