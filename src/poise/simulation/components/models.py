"""What a simulated component does: its handlers, their work, what they send and ask."""

from __future__ import annotations

from collections.abc import Mapping
from math import exp
from statistics import NormalDist

from msgspec import Struct

from poise.runtime.component.ports import Timer
from poise.simulation.schedule.choices import Choices

_NORMAL = NormalDist()
_LEAST = 1e-9


class HandlerModel(Struct, frozen=True, kw_only=True):
    """What one run of a handler costs and does.

    Parameters
    ----------
    work
        Mean [core-seconds of the reference].
    spread
        Standard deviation of its logarithm: it is drawn log-normally. 0: it is always
        the same.
    publishes
        Slot of a connector -> messages for each run, on average; None: one over each.
    calls
        Slot of a connector -> calls in each run, on average.
    """

    work: float
    spread: float = 0.0
    publishes: Mapping[str, float] | None = {}
    calls: Mapping[str, float] = {}

    def draw(self, choices: Choices) -> float:
        """Return the work of one run."""
        if not self.spread:
            return self.work
        normal = _NORMAL.inv_cdf(max(_LEAST, choices.draw("components")))
        return self.work * exp(self.spread * (normal - self.spread / 2))


class TimerModel(Struct, frozen=True, kw_only=True):
    """A timer, and what it does when it is due."""

    timer: Timer
    handler: HandlerModel


_TICK = TimerModel(
    timer=Timer("tick", 0.1),
    handler=HandlerModel(work=0.005, spread=0.5, publishes=None),
)
_TAKE = HandlerModel(work=0.005, spread=0.5)


class ComponentModel(Struct, frozen=True, kw_only=True):
    """A component, as far as placement, leases and moves are concerned.

    Parameters
    ----------
    takes, serves
        Slot of a connector -> what a message or a call that comes over it costs; the
        others cost what `other` says.
    factors
        How much dearer handlers are in each second than on average, again and again;
        empty: always the same.
    keep
        Slot -> how many messages wait at most, the oldest of them make room; the others
        have room for `MOST_KEPT`.
    start, start_later
        Shortest and longest time until it is configured [s], in a container that is
        started for it and in one that runs already.
    activate
        Longest time that `activate` or `deactivate` takes [s].
    state_size
        Of its snapshot [bytes].
    memory
        That it needs [bytes].
    """

    timers: tuple[TimerModel, ...] = (_TICK,)
    takes: Mapping[str, HandlerModel] = {}
    serves: Mapping[str, HandlerModel] = {}
    other: HandlerModel = _TAKE
    factors: tuple[float, ...] = ()
    keep: Mapping[str, int] = {}
    start: tuple[float, float] = (0.02, 0.2)
    start_later: tuple[float, float] = (0.02, 0.1)
    activate: float = 0.01
    state_size: float = 10_000
    memory: float = 10e6

    def factor(self, now: float) -> float:
        """Return how much dearer its handlers are than on average."""
        return self.factors[int(now) % len(self.factors)] if self.factors else 1.0


MOST_KEPT = 50
"""Messages of one connector that wait for a component, unless it says otherwise."""
Models = Mapping[str, ComponentModel]
"""Component -> its model; those that are not named have the default one."""


def drawn(choices: Choices, limits: tuple[float, float]) -> float:
    """Return a time from the shortest to the longest [s]."""
    return choices.between("components", *limits)
