"""Finds two incarnations of a component that worked at the same time, in their logs."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct


class HandlerRun(NamedTuple):
    """A run of a handler: the moments at which it logged that it was at work [s].

    The first one is its begin, the last one its end, unless its process was killed. A
    long handler logs often, so a long pause means that its process was stopped.
    """

    moments: tuple[float, ...]

    @property
    def begin(self) -> float:
        """When it began [s]."""
        return self.moments[0]

    @property
    def end(self) -> float:
        """When it was last at work [s]."""
        return self.moments[-1]


class IncarnationLog(Struct, frozen=True, kw_only=True):
    """The handlers that one incarnation of a component ran, in order; at least one."""

    component: str
    computer: str
    process: int
    runs: tuple[HandlerRun, ...]


class Overlap(Struct, frozen=True, kw_only=True):
    """Two incarnations of a component that worked at the same time.

    Parameters
    ----------
    computers, processes
        Of the older incarnation and of the newer one.
    since, until
        The older one was at work then, after the newer one had begun and before it
        ended [s, by the clock of the machine].
    begun
        Handlers that the older one began then.
    went_on
        For how long it ran a handler that it had begun before [s].
    """

    component: str
    computers: tuple[str, str]
    processes: tuple[int, int]
    since: float
    until: float
    begun: int
    went_on: float

    def __str__(self) -> str:
        older, newer = (
            f"process {process} on '{computer}'"
            for process, computer in zip(self.processes, self.computers, strict=True)
        )
        went_on = f" and went on with one for {self.went_on:.3f} s"
        return (
            f"'{self.component}' worked twice from {self.since:.3f} s to "
            f"{self.until:.3f} s (CLOCK_MONOTONIC): {older} began {self.begun} "
            f"handlers{went_on if self.went_on else ''} beside its successor, {newer}"
        )


def read_handler_log(folder: Path) -> list[IncarnationLog]:
    """Return what the components of a robot logged in a folder so far.

    Each file, ``component.computer.process.any``, is of one incarnation. Its lines are
    ``begin``, ``on`` or ``end`` with a time [s]. A last line that is cut short does not
    count.
    """
    logs = []
    for file in sorted(folder.iterdir()):
        component, computer, process, _ = file.name.split(".")
        if runs := _runs(file.read_text().split("\n")[:-1]):
            logs.append(
                IncarnationLog(
                    component=component,
                    computer=computer,
                    process=int(process),
                    runs=runs,
                )
            )
    return logs


def overlaps(logs: Iterable[IncarnationLog]) -> list[Overlap]:
    """Return all pairs of incarnations of a component that overlap, in time."""
    by_component = defaultdict[str, list[IncarnationLog]](list)
    for log in logs:
        by_component[log.component].append(log)
    pairs = (
        _overlap(older, newer)
        for of_one in by_component.values()
        for older, newer in combinations(sorted(of_one, key=_first_begin), 2)
    )
    return sorted((pair for pair in pairs if pair), key=lambda pair: pair.since)


def _runs(lines: list[str]) -> tuple[HandlerRun, ...]:
    runs: list[list[float]] = []
    for line in lines:
        what, at = line.split()
        if what == "begin":
            runs.append([])
        runs[-1].append(float(at))
    return tuple(HandlerRun(tuple(moments)) for moments in runs)


def _first_begin(log: IncarnationLog) -> float:
    return log.runs[0].begin


def _overlap(older: IncarnationLog, newer: IncarnationLog) -> Overlap | None:
    """Return what the older one did between the newer one's first and last moment."""
    first, last = newer.runs[0].begin, newer.runs[-1].end
    split = bisect_right(older.runs, first, key=lambda run: run.begin)
    before = older.runs[split - 1]
    beside = [m for m in before.moments if first < m <= last]
    begun = [run for run in older.runs[split:] if run.begin <= last]
    moments = [*beside, *(m for run in begun for m in run.moments)]
    if not moments:
        return None
    return Overlap(
        component=older.component,
        computers=(older.computer, newer.computer),
        processes=(older.process, newer.process),
        since=moments[0],
        until=min(moments[-1], last),
        begun=len(begun),
        went_on=beside[-1] - beside[0] if beside else 0.0,
    )
