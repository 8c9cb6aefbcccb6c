from array import array
from collections.abc import Callable
from typing import TypeAlias, final

Numbers: TypeAlias = list[float] | array[float]
Indexes: TypeAlias = list[int] | array[int]

@final
class Core:
    def __init__(
        self,
        n: int,
        m: int,
        r: int,
        demand: Numbers,
        capacity: Numbers,
        limit: Numbers,
        size: Numbers,
        restricted: Indexes,
        offsets: Indexes,
        allowed: Indexes,
        first: Indexes,
        second: Indexes,
        overhead: Numbers,
        traffic: Numbers,
        distance: Numbers,
        cost: Numbers,
        bandwidth: Numbers,
        apart_first: Indexes,
        apart_second: Indexes,
        communication: float,
        spread: Numbers,
        share: bool,
        variance: bool,
    ) -> None: ...
    def greedy(self) -> list[int]: ...
    def rehearse(self, times: int) -> float: ...
    def exact(
        self,
        known: Indexes,
        seconds: float,
        steps: int,
        stop: Callable[[], bool] | None = None,
    ) -> tuple[list[int], float, bool, str, int]: ...
    def search(
        self,
        known: Indexes,
        seconds: float,
        steps: int,
        seed: int,
        stop: Callable[[], bool] | None = None,
        thread_time: bool = False,
    ) -> tuple[list[int], float, bool, str, int]: ...
    def walk(
        self, placed: Indexes, moves: list[tuple[list[int], list[int], int, int]]
    ) -> list[tuple[float, float, float, float, float, bool]]: ...
    def multilevel(self, seed: int) -> list[int]: ...
    def terms(self, placed: Indexes) -> tuple[float, float, float]: ...
    def feasible(self, placed: Indexes) -> bool: ...
    def bound(self) -> float: ...
    @property
    def provable(self) -> bool: ...
    @property
    def bytes(self) -> int: ...
