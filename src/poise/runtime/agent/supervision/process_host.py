"""Starts container processes by way of the zygote, and shares the computer out."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path

from poise.runtime._calls import PageSampler
from poise.runtime.agent.supervision.control_link import ControlLink
from poise.runtime.agent.supervision.cpu_weights import CpuWeights, own_group
from poise.runtime.agent.supervision.oom_kills import OomKills
from poise.runtime.container import zygote
from poise.runtime.hosting.stats_page import new_memory
from poise.wire.records.deployment import ContainerSpec

_OOM_SCORE = 500
_PREPARED_OOM_SCORE = 1000
"""When memory is short, the kernel ends first what is only prepared, then other
containers, and last the agent."""


class ProcessHost:
    """The `ContainerHost` of a real computer.

    Parameters
    ----------
    zygote_socket
        The socket of the zygote, from `poise.runtime.container.zygote.start`.
    computer, folder
        The name of the computer, and the folder of the agent.
    """

    def __init__(
        self, zygote_socket: socket.socket, computer: str, folder: Path
    ) -> None:
        self._zygote = zygote_socket
        self._computer = computer
        self._folder = folder
        self._oom_kills = OomKills()
        self._weights = CpuWeights(own_group())
        self._links: list[ControlLink] = []

    @property
    def cpu_weights(self) -> str:
        """What gives containers their CPU weights, as in `AgentStatus`."""
        return self._weights.means

    def start(self, spec: ContainerSpec) -> ControlLink:
        """Ask the zygote for a container, as `ContainerHost.start` says."""
        memory = new_memory()
        try:
            wanted = zygote.Fork(
                name=spec.name,
                computer=self._computer,
                folder=os.fspath(self._folder),
                nice=self._weights.nice_of(spec),
            )
            connection = zygote.ask(self._zygote, wanted, memory)
        except BaseException:
            os.close(memory)
            raise
        return self.link(spec.name, connection, memory)

    def link(
        self, name: str, connection: socket.socket, stats_page: int
    ) -> ControlLink:
        """Return the agent's end of a connection to a container that it owns now."""
        found = ControlLink(name, connection, stats_page)
        self._links = [*self.links(), found]
        return found

    def links(self) -> list[ControlLink]:
        """Return the connections that are open; from any thread."""
        return [link for link in self._links if link.fileno() >= 0]

    def pages(self) -> list[tuple[str, int, PageSampler]]:
        """Return name, process and stats page of what was born; from any thread."""
        return [(each.name, each.pid, each.page) for each in self.links() if each.page]

    def settle(self, spec: ContainerSpec, pid: int) -> None:
        """Give a process what its container is to have of the CPU and the memory."""
        self._weights.nice_of(spec)  # makes the groups, if there are groups
        self._weights.settle(spec, pid)
        with contextlib.suppress(OSError):  # it has ended
            score = _PREPARED_OOM_SCORE if spec.spare else _OOM_SCORE
            Path(f"/proc/{pid}/oom_score_adj").write_text(str(score))

    def release(self, container: str) -> None:
        """Free what a container had that ended."""
        self._weights.forget(container)
        self._links = self.links()

    def count_kills(self, now: float) -> None:
        """Take note of processes that the kernel killed until `now` [s]."""
        self._oom_kills.look(now)

    def explain_kill(self, now: float) -> str:
        """Return why the kernel killed a process lately; empty: it killed none."""
        if not self._oom_kills.claim(now):
            return ""
        return (
            "was killed because its computer ran out of memory (OOM)"
            f"{self._oom_kills.limit()}: give the computer more, or move "
            "components to another"
        )
