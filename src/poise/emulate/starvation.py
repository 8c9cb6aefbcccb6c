"""Watches a run for windows in which the host starved a computer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from poise.clock import Clock
from poise.emulate.usage import Usage

WINDOW = 1.0
"""The shortest window [s]: long against a quota's period, short against a run."""


class Watched(Protocol):
    """The watched computer: an `EmulatedComputer`."""

    def usage(self) -> Usage:
        """Return what it has used since it was made."""
        ...

    def was_starved(self, before: Usage, after: Usage) -> bool:
        """Return whether the host made it slower than promised between the two."""
        ...


class StarvationWatch:
    """Counts how long each computer was starved, window by window.

    Parameters
    ----------
    computers
        By name; the first window begins at once.
    """

    def __init__(self, computers: Mapping[str, Watched], clock: Clock) -> None:
        self._computers = computers
        self._clock = clock
        self._starved: dict[str, float] = {}
        self._since = clock.now()
        self._before = self._usages()

    def look(self) -> None:
        """Judge the window if it has ended; call it more often than every `WINDOW`."""
        if self._clock.now() - self._since >= WINDOW:
            self._judge()

    def end(self) -> Mapping[str, float]:
        """Judge the last window; return the starved computers, and how long [s].

        The run is invalid unless the result is empty.
        """
        self._judge()
        return dict(self._starved)

    def _judge(self) -> None:
        now, after = self._clock.now(), self._usages()
        for name, computer in self._computers.items():
            before = self._before[name]
            if computer.was_starved(before, after[name]):
                lasted = now - self._since
                self._starved[name] = self._starved.get(name, 0.0) + lasted
        self._since, self._before = now, after

    def _usages(self) -> dict[str, Usage]:
        return {name: computer.usage() for name, computer in self._computers.items()}
