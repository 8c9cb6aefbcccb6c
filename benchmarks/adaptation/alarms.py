"""What Poise takes for a fault while nothing is wrong but a high load."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

from msgspec import Struct

import poise
from poise.emulate import EmulatedSet

ROBOT = Path(__file__).parents[2] / "examples/hello/robot.yaml"
LOAD = 0.95
"""Share of each computer that another program takes; the robot uses about 1 %."""
WARM_UP = 5.0
LOOK = 0.1
FAULTS = ("out of reach", "is cut", "is slow", "not responded", "cut off")


class Alarms(Struct, frozen=True, kw_only=True):
    """What was said and done under load.

    Parameters
    ----------
    seconds
        How long [s].
    used
        Computer -> the share of its CPU that was used.
    alarms
        Computers, links and containers that were said to be lost, slow or stuck, and
        since when.
    symptoms
        What else was said to be wrong: that a load makes late what runs is no error.
    moves
        Components that moved.
    """

    seconds: float
    used: Mapping[str, float]
    alarms: tuple[str, ...]
    symptoms: tuple[str, ...]
    moves: int

    def __str__(self) -> str:
        """Return it for people."""
        used = ", ".join(f"{name} {share:.0%}" for name, share in self.used.items())
        counts = f"{len(self.alarms)} false alarms, {self.moves} moves"
        head = f"{self.seconds:g} s at {used}: {counts}, and what the load made late:"
        return "\n  ".join([head, *self.alarms, *self.symptoms])


def measure(seconds: float, say: Callable[[str], None]) -> Alarms:
    """Load both computers of a small robot for so long [s]."""
    robot = poise.load(ROBOT)
    said: dict[tuple[str, float], None] = {}
    moves = 0
    with poise.emulated(robot, say=say) as kept, poise.up(robot, say=say) as running:
        time.sleep(WARM_UP)
        capacity = {c.name: c.capacity["cpu"] * c.speed for c in robot.computers}
        for name, cores in capacity.items():
            kept.load(name, LOAD * cores)
        before, used_before = running.status().placement, _used(kept)
        began = time.monotonic()
        while time.monotonic() - began < seconds:
            time.sleep(LOOK)
            status = running.status()
            said |= dict.fromkeys((d.what, round(d.since)) for d in status.deviations)
            said |= dict.fromkeys(
                (f"'{name}' is out of reach", round(since))
                for name, since in status.out_of_reach.items()
            )
            moves += sum(before.get(n) != at for n, at in status.placement.items())
            before = status.placement
        took = time.monotonic() - began
        used = {n: (u - used_before[n]) / took for n, u in _used(kept).items()}
    alarms = [each for each in said if any(what in each[0] for what in FAULTS)]
    return Alarms(
        seconds=seconds,
        used={name: used[name] / cores for name, cores in capacity.items()},
        alarms=tuple(map(_sentence, alarms)),
        symptoms=tuple(_sentence(each) for each in said if each not in alarms),
        moves=moves,
    )


def _used(kept: EmulatedSet) -> dict[str, float]:
    return {name: each.usage().used for name, each in kept.computers.items()}


def _sentence(said: tuple[str, float]) -> str:
    return f"{time.strftime('%H:%M:%S', time.localtime(said[1]))} {said[0]}"
