"""The interface of process groups, and groups without the kernel's help."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from poise.emulate.limits import Limits
from poise.emulate.processes import marked
from poise.emulate.usage import Usage


class Group(Protocol):
    """All processes of one emulated computer, and its limits. Nothing here blocks."""

    joins: tuple[Path, ...]
    """A process enters by writing its number into each of these files."""

    def processes(self) -> list[int]:
        """Return the numbers of the processes in it."""
        ...

    def usage(self) -> Usage:
        """Return its usage since it was made."""
        ...


class Groups(Protocol):
    """Makes groups; one implementation for each way to limit processes."""

    controls: frozenset[str]
    """Which of ``cpu``, ``cpuset`` and ``memory`` its groups limit."""

    def folders(self, name: str) -> tuple[Path, ...]:
        """Return the folders that a group called `name` will have."""
        ...

    def aside(self, name: str) -> tuple[Path, ...]:
        """Return where `prepare` moves processes that are in the way."""
        ...

    def prepare(self, name: str) -> None:
        """Prepare the first group of run `name`; called once."""
        ...

    def make(self, name: str, limits: Limits) -> Group:
        """Make a group; OSError when the kernel refuses."""
        ...


class MarkedGroups:
    """Groups without limits; processes belong to one by an inherited mark."""

    controls: frozenset[str] = frozenset()

    def folders(self, name: str) -> tuple[Path, ...]:
        """Return none."""
        del name
        return ()

    def aside(self, name: str) -> tuple[Path, ...]:
        """Return none."""
        del name
        return ()

    def prepare(self, name: str) -> None:
        """Do nothing."""

    def make(self, name: str, limits: Limits) -> Group:
        """Return the group of all processes that carry the mark `name`."""
        del limits
        return MarkedGroup(name)


class MarkedGroup:
    """The processes that inherited one mark in their environment."""

    joins: tuple[Path, ...] = ()

    def __init__(self, mark: str) -> None:
        self._mark = mark

    def processes(self) -> list[int]:
        """Return the numbers of the processes in it."""
        return marked(self._mark)

    def usage(self) -> Usage:
        """Return the CPU time of those processes that still run."""
        used = 0.0
        for pid in self.processes():
            with suppress(OSError):  # it has ended
                # Linux's name for "the CPU-time clock of process pid".
                used += time.clock_gettime((~pid << 3) | 2)
        return Usage(used=used)
