"""What happens to a robot of three computers within five minutes, by seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from random import Random

import numpy as np
import numpy.typing as npt

Cores = npt.NDArray[np.float64]
Placement = tuple[int, ...]
"""The computer of each component."""

STEP = 0.5
"""Everything stays the same for this long [s]."""
SECONDS = 300.0
NUM_STEPS = round(SECONDS / STEP)
NUM_COMPUTERS = 3
STEADY = np.ones(NUM_STEPS)
LARGEST = 0.9
"""A component needs at most this share of the slowest computer."""


@dataclass(frozen=True, kw_only=True)
class Trace:
    """What components need and other programs leave, in all steps.

    Parameters
    ----------
    capacity
        Of each computer [cores of the reference].
    demands
        What each component needs, (n_steps, n_components) [cores of the reference].
    background
        What other programs want, (n_steps, n_computers) [cores of the reference].
    lost
        Whether a computer is out of reach, (n_steps, n_computers).
    pins
        The computer of a component that has a device there; None: it may move.
    start
        The placement in the first step.
    """

    kind: str
    seed: int
    capacity: Cores
    demands: Cores
    background: Cores
    lost: npt.NDArray[np.bool_]
    pins: tuple[int | None, ...]
    start: Placement

    @property
    def left(self) -> Cores:
        """What other programs leave, (n_steps, n_computers) [cores]; 0 when lost."""
        left = np.maximum(0.0, self.capacity - self.background)
        return np.where(self.lost, 0.0, left)

    @property
    def load(self) -> float:
        """The share of all capacity that is needed or wanted, in the mean."""
        wanted = self.demands.sum(axis=1) + self.background.sum(axis=1)
        return float(wanted.mean() / self.capacity.sum())


def trace(kind: str, seed: int, loads: tuple[float, float]) -> Trace:
    """Return what happens; the mean load is within `loads`."""
    chance = Random(f"{kind} {seed} {loads}")
    speeds = [1.0] * NUM_COMPUTERS
    if seed % 3 == 2:
        speeds = chance.sample([0.7, 1.0, 1.3], NUM_COMPUTERS)
    capacity = np.array(speeds)
    count = chance.choice([6, 7])
    load = chance.uniform(*loads) * sum(speeds)
    of_components = load * chance.uniform(0.45, 0.7)
    sizes = [chance.uniform(0.5, 1.5) for _ in range(count)]
    # half of the components vary, and by less than other programs do
    shapes = [_shape(kind, chance) if i % 2 else STEADY for i in range(count)]
    needs = [
        size * (0.5 + 0.5 * shape) for size, shape in zip(sizes, shapes, strict=True)
    ]
    largest = np.full(count, LARGEST * min(speeds))
    demands = _scaled(np.stack(needs, 1), of_components, largest)
    others = [chance.uniform(0.2, 1.0) * _shape(kind, chance) for _ in speeds]
    background = _scaled(np.stack(others, 1), load - of_components, capacity)
    pinned = dict.fromkeys(chance.sample(range(count), chance.choice([1, 2])))
    pins = tuple(
        chance.randrange(NUM_COMPUTERS) if i in pinned else None for i in range(count)
    )
    return Trace(
        kind=kind,
        seed=seed,
        capacity=capacity,
        demands=demands,
        background=background,
        lost=_lost(kind, chance),
        pins=pins,
        start=_start(demands[0], capacity, pins),
    )


def _scaled(shapes: Cores, mean: float, most: Cores) -> Cores:
    """Return shapes of this mean in all, none above its `most` [cores]."""
    factor = 1.0
    for _ in range(50):
        scaled = np.minimum(shapes * factor, most)
        factor *= mean / scaled.sum(axis=1).mean()
    return scaled


def _start(demands: Cores, capacity: Cores, pins: tuple[int | None, ...]) -> Placement:
    """Return where components begin: the largest first, where most is left."""
    left, placement = capacity.copy(), [0] * len(pins)
    for i in sorted(range(len(pins)), key=lambda i: (pins[i] is None, -demands[i])):
        pin = pins[i]
        placement[i] = int(np.argmax(left)) if pin is None else pin
        left[placement[i]] -= demands[i]
    return tuple(placement)


def _lost(kind: str, chance: Random) -> npt.NDArray[np.bool_]:
    lost = np.zeros((NUM_STEPS, NUM_COMPUTERS), dtype=bool)
    computer, at = chance.randrange(NUM_COMPUTERS), chance.uniform(60, 120)
    if kind == "lost":
        lost[
            round(at / STEP) : round((at + chance.uniform(40, 100)) / STEP), computer
        ] = True
    if kind == "flapping":
        end = at + 100
        while at < end:
            back = at + chance.uniform(2, 10)
            lost[round(at / STEP) : round(back / STEP), computer] = True
            at = back + chance.uniform(3, 20)
    return lost


def _levels(chance: Random) -> Iterator[float]:
    """Jump now and then, and stay."""
    level = 0.0
    while True:
        if not level or chance.random() < STEP / 60:
            level = chance.uniform(0.2, 2.0)
        yield level


def _wave(chance: Random) -> Iterator[float]:
    """Come and go in equal parts."""
    period, phase = chance.uniform(5, 120), chance.random()
    high = chance.uniform(1.2, 2.0)
    at = 0.0
    while True:
        yield high if (at / period + phase) % 1 < 0.5 else 2.0 - high
        at += STEP


def _bursts(chance: Random) -> Iterator[float]:
    """Be low, and high for a few seconds."""
    high, left = 0.0, 0.0
    while True:
        if left <= 0 and chance.random() < STEP / 30:
            high, left = chance.uniform(1.0, 3.0), chance.expovariate(1 / 6)
        yield 0.5 + (high if left > 0 else 0.0)
        left -= STEP


def _walk(chance: Random) -> Iterator[float]:
    """Change by little in each step."""
    level = chance.uniform(0.5, 1.5)
    while True:
        level = min(2.0, max(0.1, level + chance.gauss(0, 0.06)))
        yield level


_SHAPES: Mapping[str, Callable[[Random], Iterator[float]]] = {
    "steps": _levels,
    "periodic": _wave,
    "bursts": _bursts,
    "walk": _walk,
}
KINDS = (*_SHAPES, "lost", "flapping")
"""When a computer is lost, loads are of any of the other kinds."""


def _shape(kind: str, chance: Random) -> Cores:
    """Return a load over time, (n_steps,), of any scale."""
    shape = _SHAPES.get(kind) or chance.choice([*_SHAPES.values()])
    return np.fromiter(shape(chance), dtype=float, count=NUM_STEPS)
