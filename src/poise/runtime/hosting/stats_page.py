"""What a container counts, where its agent reads it: in memory that both have.

Nobody is woken for it and nothing is sent. The container's threads add to numbers in
place; the agent looks at all containers at once and asks the kernel for the CPU time of
their components' threads. The code is native (``native/ledger.h``, ``reader.h``).
"""

from __future__ import annotations

import fcntl
import logging
import os
from collections.abc import Iterable, Mapping

from poise.runtime import _calls
from poise.runtime._calls import Account, Counts, Reader
from poise.runtime.hosting.command_line import Command
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import OpenEndpoints

log = logging.getLogger(__name__)

MOST = 8192
"""Components, timers and ends of connectors that fit; lines that are never used take no
memory."""

Incarnation = tuple[str, int]


def new_memory() -> int:
    """Return the descriptor of memory for one ledger, which never becomes smaller."""
    fd = os.memfd_create("ledger", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(fd, MOST * _calls.LINE_SIZE)
    fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
    return fd


class StatsPage:
    """A container's ledger.

    Parameters
    ----------
    memory
        A descriptor from `new_memory`; it is closed here.
    """

    def __init__(self, memory: int) -> None:
        self._native = _calls.Ledger(memory)
        self._reader = Reader(memory, os.getpid())
        os.close(memory)
        self._shown: dict[int, Account | Counts] = {}

    def show(
        self,
        running: Mapping[Incarnation, Runner | Command],
        ends: Iterable[OpenEndpoints],
    ) -> None:
        """Let the agent see the accounts and counts of these, and of no others."""
        accounts = {key: each.account for key, each in running.items()}
        connectors = list(ends)
        wanted: list[Account | Counts] = [*accounts.values()]
        wanted += [each.counts for each in connectors]
        ids = {id(each) for each in wanted}
        for key in self._shown.keys() - ids:
            self._shown.pop(key).leave()
        for (name, epoch), account in accounts.items():
            if self._is_new(account) and not account.enter(self._native, name, epoch):
                self._refuse(account, f"component '{name}'")
        for each in connectors:
            spec, counts = each.spec, each.counts
            if self._is_new(counts) and not counts.enter(self._native, spec.name):
                self._refuse(counts, f"connector {spec.name}")
            # during a move an outlet has two paths: the later one is the one it uses
            counts.attribute(
                accounts.get((spec.source, spec.source_epoch)),
                accounts.get((spec.target, spec.target_epoch)),
            )

    def cpu(self) -> dict[Incarnation, float]:
        """Return the CPU time of each component so far [s]."""
        found = self._reader.read()
        return {} if found is None else {(c[0], c[1]): c[2] for c in found[2]}

    def _is_new(self, each: Account | Counts) -> bool:
        is_new = id(each) not in self._shown
        self._shown[id(each)] = each
        return is_new

    def _refuse(self, each: Account | Counts, what: str) -> None:
        del self._shown[id(each)]
        log.warning("%s is not counted: the ledger's %d lines are full", what, MOST)
