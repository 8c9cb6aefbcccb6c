"""Other programs overload a computer of a running robot."""

from __future__ import annotations

import math
import time

from msgspec import Struct
from msgspec.structs import replace

from examples.adapt.grid import shortest
from examples.demo.waiting import LOOK_EVERY, WARM_UP, Check, Say, wait
from poise import Robot, Running, place, up
from poise.emulate import background_load
from poise.model import ComponentEntry

_WATCH = 15.0
"""How long a robot is watched after something happened to it [s]."""
_LOAD = 0.45
"""What each of two other programs wants [cores]."""
_SEARCH = 0.018
"""How long a planner searches, ten times a second [s of CPU]. Two planners fit on a
computer; beside two other programs, which get as much as they, both are late."""
_TRIALS, _TRIAL_SIZE = 20, 110
_SETTLES = 2.0
"""The moves of one transition are made within this time [s]."""


class OverloadScene(Struct, frozen=True, kw_only=True):
    """Other programs take CPU on the computer where all components run.

    Parameters
    ----------
    met_again_s
        From the start of the load until deadlines were met for good [s].
    moves_after
        Components that moved after that.
    missed, missed_without
        Share of the deadlines that were missed while the load lasted: with adaptation,
        and of the same robot without it; in [0, 1].
    """

    scene: str = "overload"
    ok: bool
    met_again_s: float
    moves_after: int
    missed: float
    missed_without: float


def overload(robot: Robot, say: Say, check: Check) -> OverloadScene:
    """Load the computer on which all components run, with and without adaptation."""
    size = map_size()
    say(f"on this machine a search takes {1e3 * _SEARCH:g} ms with a map of {size}²")
    robot = _with_size(robot, size)
    without, *_ = _under_load(robot, say, check, adapt=False)
    missed, met_again, moves_after = _under_load(robot, say, check, adapt=True)
    return OverloadScene(
        ok=missed < without and moves_after == 0 and met_again < _WATCH,
        met_again_s=met_again,
        moves_after=moves_after,
        missed=missed,
        missed_without=without,
    )


def map_size() -> int:
    """Return how large a map must be for a search to take `_SEARCH` on this machine."""
    times = []
    for _ in range(_TRIALS):
        began = time.thread_time()
        shortest(_TRIAL_SIZE, set())
        times.append(time.thread_time() - began)
    return round(_TRIAL_SIZE * math.sqrt(_SEARCH / min(times)))


def _with_size(robot: Robot, size: int) -> Robot:
    """Return the robot with planners whose maps are `size` cells wide."""

    def sized(component: ComponentEntry) -> ComponentEntry:
        if "size" not in component.parameters:
            return component
        demand = {**component.demand, "cpu": 10 * _SEARCH}
        return replace(component, parameters={"size": size}, demand=demand)

    architectures = (
        replace(each, components=tuple(map(sized, each.components)))
        for each in robot.architectures
    )
    return replace(robot, architectures=tuple(architectures))


def _under_load(
    robot: Robot, say: Say, check: Check, *, adapt: bool
) -> tuple[float, float, int]:
    """Return the share missed, when deadlines were met again [s], and later moves."""
    say("with adaptation" if adapt else "without adaptation")
    placed = place(robot, method="static")
    with up(robot, placement=placed, adapt=adapt, say=say, check=check) as running:
        wait(WARM_UP, check)
        count = Deadlines(running)
        loaded = next(iter(placed.where.values()))
        say(f"two other programs want {_LOAD:g} cores each on '{loaded}'")
        computer = running.emulated[loaded]
        programs = [computer.popen(background_load(_LOAD)) for _ in range(2)]
        began = time.monotonic()
        met_again, places = 0.0, running.status().placement
        moves: list[float] = []
        while (now := time.monotonic() - began) < _WATCH:
            wait(LOOK_EVERY, check)
            if count.look():
                met_again = now
            where = running.status().placement
            moves += [now for name, at in where.items() if places[name] != at]
            places = where
        for program in programs:
            program.kill()
    say(f"{count.missed} of {count.released} deadlines missed under the load")
    settled = max([met_again, *(at + _SETTLES for at in moves[:1])])
    return count.share(), met_again, sum(at > settled for at in moves)


class Deadlines:
    """Counts deadlines, and those missed, over all incarnations of the components."""

    def __init__(self, running: Running) -> None:
        self._running = running
        self._before: dict[tuple[str, int, str], tuple[int, int]] = {}
        self.released = self.missed = 0
        self.look()
        self.released = self.missed = 0

    def look(self) -> bool:
        """Count what came since the last look; return whether a deadline was missed."""
        missed = 0
        for _, component in self._running.status().located():
            for timer in component.timers:
                key = component.name, component.epoch, timer.name
                released, late = self._before.get(key, (0, 0))
                self.released += timer.releases - released
                missed += timer.missed - late
                self._before[key] = timer.releases, timer.missed
        self.missed += missed
        return missed > 0

    def share(self) -> float:
        """Return the share that was missed; in [0, 1]."""
        return self.missed / self.released if self.released else 1.0
