"""Starts container processes by way of the zygote, and shares the computer out."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
from collections import deque
from collections.abc import Iterable
from pathlib import Path

from poise.kernel_counters import (
    CPU_GROUP,
    PREPARED,
    PRESSURE_GROUP,
    ComputerMemory,
    memory_group,
    mounts,
    table,
)
from poise.priority import REAL_TIME
from poise.runtime._calls import LeaseEnd, PageSampler
from poise.runtime.container import zygote
from poise.runtime.execution.counters import new_memory
from poise.units import format_bytes
from poise.wire import frame
from poise.wire.records.deployment_records import ContainerSpec
from poise.wire.records.status_records import FromContainer, ToContainer

_LATE = 10.0
"""The end of a killed process is known within this time after the kill [s]."""
_OOM_SCORE = 500
_PREPARED_OOM_SCORE = 1000
"""When memory is short, the kernel ends first what is only prepared, then other
containers, and last the agent."""
log = logging.getLogger(__name__)
_MOST = 10_000
"""The highest weight that the kernel takes: the agent's own."""
_SHARES = 10.24
"""Shares of version 1 for a weight of 1 of version 2."""
_LEAST_QUOTA = 0.001
"""The kernel counts quotas from this on [s]."""
_PERIOD = 0.02
"""What a quota is counted over, or longer where it would be too small [s]."""


class ControlLink:
    """A `ContainerControl` of a real process."""

    def __init__(self, name: str, connection: socket.socket, stats_page: int) -> None:
        self.name = name
        self.pid = 0
        self.page: PageSampler | None = None
        self._connection = connection
        self._reader = frame.RecordReader(connection)
        self._writer = frame.RecordWriter(connection)
        self._stats_page = stats_page
        self._lease: LeaseEnd | None = None

    def fileno(self) -> int:
        """Return the descriptor to wait for; negative: it is closed."""
        return self._connection.fileno()

    def next(self) -> FromContainer | None:
        """Return what the container says next, as `RecordReader.next` does."""
        record: FromContainer | None = self._reader.next(FromContainer)
        return record

    def note_born(self, pid: int) -> None:
        """Take note of its process; OSError or RuntimeError: no memory is free."""
        self.pid = pid
        self.page = PageSampler(self._stats_page, pid)
        self._lease = LeaseEnd(self._stats_page)

    def send(self, record: ToContainer) -> None:
        """Tell it something; raises as `frame.RecordWriter.push`."""
        self._writer.push(record)

    def flush(self) -> None:
        """Send more of what it had no room for; Unavailable: it is gone."""
        self._writer.flush()

    @property
    def is_waiting(self) -> bool:
        """Whether something is left for `flush`."""
        return self._writer.is_waiting

    def signal(self, number: signal.Signals) -> None:
        """Send its process a signal; harmless when that has ended."""
        if self.pid:
            with contextlib.suppress(ProcessLookupError):  # its end is reported
                os.kill(self.pid, number)

    def extend_lease(self, until: float) -> None:
        """Let its leased components act until then [s, boot time]; any thread."""
        if self._lease is not None:
            self._lease.at = until

    def is_lease_past(self) -> bool:
        """Return whether its leased components may not act; raises as `note_born`."""
        lease = self._lease or LeaseEnd(self._stats_page)
        return lease.is_past()

    def heartbeat(self) -> int | None:
        """Return how often its control thread has run; None before it is born."""
        return None if self.page is None else self.page.heartbeat()

    def close(self) -> None:
        """Let go of socket and page."""
        if self._connection.fileno() >= 0:
            self._connection.close()
            os.close(self._stats_page)


class OomKills:
    """The kills of this process's cgroup, each of which explains one end."""

    def __init__(self, proc: Path = Path("/proc")) -> None:
        mount = memory_group(proc)
        group = mount.own if mount is not None else Path("/nonexistent")
        counters = [
            group / "memory.events",
            group / "memory.oom_control",
            proc / "vmstat",
        ]
        self._file = next((f for f in counters if _count(f) is not None), None)
        self._memory = ComputerMemory(proc)
        self._counted = (_count(self._file) or 0) if self._file else 0
        self._unclaimed: deque[float] = deque()

    def update(self, now: float) -> None:
        """Take note of kills until `now` [s]; call it a few times a second."""
        count = _count(self._file) if self._file else None
        if count is None:  # no file descriptor is free at the moment
            count = self._counted
        self._unclaimed.extend([now] * (count - self._counted))
        self._counted = count
        while self._unclaimed and self._unclaimed[0] < now - _LATE:
            self._unclaimed.popleft()

    def claim(self, now: float) -> bool:
        """Return whether a kill explains an end at `now` [s]; it explains no other."""
        self.update(now)
        if not self._unclaimed:
            return False
        self._unclaimed.popleft()
        return True

    def limit(self) -> str:
        """Return the memory limit of this computer in words; empty: none is known."""
        limit = self._memory.size()
        return f" (limit {format_bytes(limit)})" if limit else ""


def _count(file: Path) -> int | None:
    try:
        return table(file.read_text()).get("oom_kill")
    except OSError:
        return None


class ProcessHost:
    """The `ContainerHost` of a real computer."""

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
        except BaseException:  # nobody else has the descriptor yet
            os.close(memory)
            raise
        return self.link(spec.name, connection, memory)

    def link(
        self, name: str, connection: socket.socket, stats_page: int
    ) -> ControlLink:
        """Return the agent's end of a connection to a container that it owns now."""
        link = ControlLink(name, connection, stats_page)
        self._links = [*self.links(), link]
        return link

    def links(self) -> list[ControlLink]:
        """Return the connections that are open; from any thread."""
        return [link for link in self._links if link.fileno() >= 0]

    def pages(self) -> list[tuple[str, int, PageSampler]]:
        """Return name, process and stats page of what was born; from any thread."""
        return [(link.name, link.pid, link.page) for link in self.links() if link.page]

    def settle(self, spec: ContainerSpec, pid: int) -> None:
        """Give a process what its container is to have of the CPU and the memory."""
        self._weights.nice_of(spec)  # makes the groups, if there are groups
        self._weights.settle(spec, pid)
        with contextlib.suppress(OSError):  # it has ended
            score = _PREPARED_OOM_SCORE if spec.preparation_cpu else _OOM_SCORE
            Path(f"/proc/{pid}/oom_score_adj").write_text(str(score))

    def release(self, container: str) -> None:
        """Free what a container had that ended."""
        self._weights.forget(container)
        self._links = self.links()

    def count_kills(self, now: float) -> None:
        """Take note of processes that the kernel killed until `now` [s]."""
        self._oom_kills.update(now)

    def explain_kill(self, now: float) -> str:
        """Return why the kernel killed a process lately; empty: it killed none."""
        if not self._oom_kills.claim(now):
            return ""
        return (
            "was killed because its computer ran out of memory (OOM)"
            f"{self._oom_kills.limit()}: give the computer more, or move "
            "components to another"
        )


class CpuWeights:
    """Gives containers their weights; for the agent's own thread."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self.means = ""

    def nice_of(self, spec: ContainerSpec) -> int:
        """Return the nice value with which a container is to begin."""
        if spec.weight and not self.means:
            self.means = self._prepared()
        return spec.nice if self.means == "nice" else 0

    def settle(self, spec: ContainerSpec, pid: int) -> None:
        """Put a container that began, or goes to work, into its group."""
        if not spec.weight or self._folder is None or self.means == "nice":
            return
        group = self._folder / (
            PREPARED if spec.preparation_cpu else f"container-{spec.name}"
        )
        try:
            group.mkdir(exist_ok=True)
            if spec.preparation_cpu:
                _hold_back(group, spec.preparation_cpu)
            else:
                _weigh(group, spec.weight)
            _enter(group, [pid])
            if pressure := os.environ.get(PRESSURE_GROUP):
                apart = Path(pressure, PREPARED if spec.preparation_cpu else "")
                apart.mkdir(exist_ok=True)
                _enter(apart, [pid])
        except OSError as error:
            log.warning(
                "container '%s' has no CPU weight of its own: %s", spec.name, error
            )

    def forget(self, name: str) -> None:
        """Remove the group of a container that ended."""
        if self._folder is not None and self.means:
            # what is not empty yet is used again, or ends with the computer
            with contextlib.suppress(OSError):
                (self._folder / f"container-{name}").rmdir()

    def _prepared(self) -> str:
        """Return what can be used; with groups, the agent is in one itself then."""
        if self._folder is None:
            return "nice"
        is_real_time = os.environ.get(REAL_TIME) == "1"
        # in groups of version 1 no thread may go to real time
        if is_real_time and (self._folder / "cpu.rt_runtime_us").exists():
            return "nice"
        try:
            return self._use_groups(self._folder)
        except OSError as error:
            log.info("containers get nice values, not cgroups: %s", error)
            return "nice"

    @staticmethod
    def _use_groups(folder: Path) -> str:
        control, agent = folder / "cgroup.subtree_control", folder / "agent"
        agent.mkdir(exist_ok=True)
        _enter(agent, [os.getpid()])
        version = 1
        if control.exists():
            version = 2
            # who hands controllers on has no processes itself
            _enter(agent, map(int, (folder / "cgroup.procs").read_text().split()))
            control.write_text("+cpu")
        _weigh(agent, _MOST)
        return f"cgroup v{version}"


def own_group() -> Path | None:
    """Return the folder of the CPU cgroup in which this process may make others."""
    folder = os.environ.get(CPU_GROUP)
    if folder is not None:
        return Path(folder) if folder else None
    for mount in mounts():
        group = mount.own
        if group == mount.top or "cpu" not in mount.controllers:
            continue
        if group.name == "agent":  # of an agent before, or systemd's DelegateSubgroup
            group = group.parent
        if os.access(group / "cgroup.procs", os.W_OK):
            return group
    return None


def _enter(group: Path, pids: Iterable[int]) -> None:
    """Move processes with all their threads into a group; one that ended is none."""
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            (group / "cgroup.procs").write_text(str(pid))


def _weigh(group: Path, weight: int) -> None:
    shares = group / "cpu.shares"
    if shares.exists():
        shares.write_text(str(round(weight * _SHARES)))
    else:
        (group / "cpu.weight").write_text(str(weight))


def _hold_back(group: Path, cores: float) -> None:
    """Let a group have the CPU when nobody else wants it, and at most some cores."""
    period = max(_PERIOD, _LEAST_QUOTA / cores)
    quota_us, period_us = round(cores * period * 1e6), round(period * 1e6)
    if (group / "cpu.shares").exists():
        (group / "cpu.cfs_period_us").write_text(str(period_us))
        (group / "cpu.cfs_quota_us").write_text(str(quota_us))
    else:
        (group / "cpu.max").write_text(f"{quota_us} {period_us}")
    if (idle := group / "cpu.idle").exists():  # Linux 5.15
        idle.write_text("1")
    else:
        _weigh(group, 1)
