"""A robot under a background load: with Poise's adaptation, none, and random moves.

It imports internal modules: it counts deadlines as a scene of the demo does.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Literal

from msgspec import Struct

import poise
from examples.demo.overload import Deadlines
from poise.emulate.cpu_load import background_load
from poise.errors import PoiseError
from poise.session.running_robots.running import Running, Status

Arm = Literal["poise", "none", "random"]
ARMS: tuple[Arm, ...] = ("poise", "none", "random")
ROBOT = Path(__file__).parents[2] / "examples/adapt/robot.yaml"
WARM_UP = 4.0
LOOK = 0.1
COOL_DOWN = 3.0
"""Random adaptation moves again after this time at the earliest [s], as Poise does."""


class Trial(Struct, frozen=True, kw_only=True):
    """One robot under one load.

    Parameters
    ----------
    load
        What the other program takes [cores].
    missed
        The share of the deadlines missed while the load lasted; in [0, 1].
    met_again_s
        From the start of the load until deadlines were met for good [s]; not before the
        end of the trial when it is as long.
    moves
        Components that moved meanwhile.
    last_move_s
        From the start of the load until the last one did [s]; 0: none.
    """

    arm: Arm
    seed: int
    load: float
    missed: float
    met_again_s: float
    moves: int
    last_move_s: float


class Summary(Struct, frozen=True, kw_only=True):
    """The medians of one arm's trials."""

    trials: int
    missed: float
    met_again_s: float
    moves: float
    last_move_s: float


def compare(
    seeds: int, seconds: float, say: Callable[[str], None], arms: Sequence[Arm] = ARMS
) -> list[Trial]:
    """Run every arm under the same loads, in turn."""
    found = []
    for seed in range(seeds):
        for arm in arms:
            trial = measure(arm, seed, seconds)
            say(
                f"seed {seed}, {trial.load:.2f} cores of load, {arm}: "
                f"{trial.missed:.1%} missed, met again after "
                f"{trial.met_again_s:.1f} s, {trial.moves} moves, the last after "
                f"{trial.last_move_s:.1f} s of {seconds:g} s"
            )
            found.append(trial)
    return found


def summary(trials: list[Trial]) -> dict[str, Summary]:
    """Return the medians by arm."""
    return {
        arm: Summary(
            trials=len(own),
            missed=median(t.missed for t in own),
            met_again_s=median(t.met_again_s for t in own),
            moves=median(t.moves for t in own),
            last_move_s=max(t.last_move_s for t in own),
        )
        for arm in ARMS
        if (own := [t for t in trials if t.arm == arm])
    }


def measure(arm: Arm, seed: int, seconds: float) -> Trial:
    """Load the computer on which all components run."""
    chance = random.Random(seed)
    load, delay = chance.uniform(0.35, 0.5), chance.uniform(0.0, 1.0)
    robot = poise.load(ROBOT)
    placed = poise.place(robot, method="static")
    home = next(iter(placed.where.values()))
    with poise.up(robot, placement=placed, adapt=arm == "poise") as running:
        time.sleep(WARM_UP + delay)
        movers = _Mover(running, robot, chance) if arm == "random" else None
        deadlines = Deadlines(running)
        hog = running.emulated[home].popen(background_load(load))
        began = time.monotonic()
        met_again, last_move, moves = 0.0, 0.0, 0
        before = running.status().placement
        while (now := time.monotonic() - began) < seconds:
            time.sleep(LOOK)
            if deadlines.look():
                met_again = now
            status = running.status()
            if moved := sum(before[n] != at for n, at in status.placement.items()):
                moves, last_move = moves + moved, now
            before = status.placement
            if movers is not None:
                movers.look(status)
        hog.kill()
    return Trial(
        arm=arm,
        seed=seed,
        load=load,
        missed=deadlines.share(),
        met_again_s=met_again,
        moves=moves,
        last_move_s=last_move,
    )


class _Mover:
    """Moves a random component to a random computer while something is wrong."""

    def __init__(
        self, running: Running, robot: poise.Robot, chance: random.Random
    ) -> None:
        self._running = running
        self._chance = chance
        self._components = sorted(c.name for c in robot.components() if c.movable)
        self._computers = [c.name for c in robot.computers]
        self._rests_until = 0.0

    def look(self, status: Status) -> None:
        """Move one, when a symptom has lasted: then it is among the deviations."""
        now = time.monotonic()
        if not status.deviations or now < self._rests_until:
            return
        component = self._chance.choice(self._components)
        others = [c for c in self._computers if c != status.placement[component]]
        try:
            self._running.move(component, self._chance.choice(others), force=True)
        except PoiseError as error:
            sys.stderr.write(f"random adaptation: {error}\n")
        self._rests_until = time.monotonic() + COOL_DOWN
