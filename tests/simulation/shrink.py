"""Finds a shorter run with the same failure: fewer faults first, then fewer choices."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from msgspec import structs

from poise.simulation.faults import SimulatedFault
from poise.simulation.scheduler import ENGINE
from tests.simulation.simulated_run import RunOutcome, Scenario, simulate

MOST_RUNS = 500
T = TypeVar("T")
Recorded = Mapping[str, Sequence[float]]


class Shrunk:
    """The shortest run so far that shows a failure.

    `first`: the run that failed.
    `outcome`, `scenario`, `recorded`: that run; `simulate` repeats it with these.
    `runs`: how many runs it took.
    """

    def __init__(self, scenario: Scenario, first: RunOutcome) -> None:
        self.runs, self._most = 0, MOST_RUNS
        self.outcome = first
        self.scenario = structs.replace(scenario, faults=first.faults)
        self.recorded: Recorded = {}
        if not self._try(self.scenario, {}):
            # the faults' own draws came before: without them all others are as before
            self._try(self.scenario, first.choices)

    def shrink(self, most: int = MOST_RUNS) -> None:
        """Take away what the failure does not need, in at most so many runs."""
        self._most = most
        cut = self.outcome.virtual
        faults = tuple(f for f in self.outcome.faults if f.at <= cut)
        self._try(structs.replace(self.scenario, faults=faults), self.recorded)
        self._drop(lambda: self.scenario.faults or (), self._with_faults)
        self._try(structs.replace(self.scenario, moves=False), self.recorded)
        self._drop(lambda: self.scenario.faults or (), self._with_faults)
        for stream in ("clients", "schedule", "network", "components", ENGINE):
            self._calm(stream)

    def _with_faults(self, faults: Sequence[SimulatedFault]) -> bool:
        scenario = structs.replace(self.scenario, faults=tuple(faults))
        return self._try(scenario, self.recorded)

    def _drop(
        self, items: Callable[[], Sequence[T]], without: Callable[[Sequence[T]], bool]
    ) -> None:
        """Leave out as much as can be: large parts first, then single ones."""
        size = max(1, len(items()) // 2)
        while True:
            start = 0
            while start < len(items()):
                left = [*items()[:start], *items()[start + size :]]
                if not without(left):
                    start += size
            if size == 1:
                return
            size //= 2

    def _calm(self, stream: str) -> None:
        """Let choices of a stream be the first that offers, in halves."""
        parts = [(0, len(self.outcome.choices.get(stream, ())))]
        while parts and self.runs < self._most:
            start, end = parts.pop(0)
            made = list(self.outcome.choices.get(stream, ()))
            if start >= len(made) or not any(made[start:end]):
                continue
            calm = [*made[:start], *[0.0] * (min(end, len(made)) - start), *made[end:]]
            recorded = {**self.outcome.choices, stream: calm}
            smallest = max(1, len(made) // 16)
            if not self._try(self.scenario, recorded) and end - start > smallest:
                middle = (start + end) // 2
                parts += [(start, middle), (middle, end)]

    def _try(self, scenario: Scenario, recorded: Recorded) -> bool:
        """Run it; keep it when it fails in the same way."""
        if self.runs >= self._most:
            return False
        self.runs += 1
        outcome = simulate(scenario, self.outcome.seed, recorded)
        is_same = outcome.signature == self.outcome.signature
        if is_same:
            self.scenario, self.recorded, self.outcome = scenario, recorded, outcome
        return is_same
