"""The solvers of the C++ core, one by one, as the tests call them."""

from poise.plan._core import Core
from poise.plan.planner import UNLIMITED
from poise.plan.problem.arrays import Arrays, Placed
from poise.plan.result_records import Answer


class Native:
    """A problem compiled into the core."""

    def __init__(self, arrays: Arrays) -> None:
        self.arrays = arrays
        self.core = Core(arrays)
        self.bound = self.core.bound
        self.feasible = self.core.feasible

    def greedy(self) -> Placed:
        return self.core.greedy()[0]

    def total(self, placed: Placed) -> float:
        return sum(self.core.terms(placed))

    def exact(
        self,
        known: Placed,
        seconds: float = 1e9,
        steps: int = UNLIMITED,
        stop: object = None,
    ) -> Answer:
        return Answer(*self.core.exact(known, seconds, steps, stop))

    def search(
        self,
        known: Placed,
        seconds: float = 1e9,
        steps: int = UNLIMITED,
        seed: int = 0,
        stop: object = None,
    ) -> Answer:
        return Answer(*self.core.search(known, seconds, steps, seed, stop))
