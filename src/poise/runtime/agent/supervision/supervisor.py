"""Starts, watches and ends the container processes of one computer.

It compares the containers that should run with those that run and takes the smallest
step. A container that ended is started again after a delay that grows. Those that an
earlier agent left are adopted (`AdoptedContainers`).
"""

from __future__ import annotations

import contextlib
import logging
import os
import random
import socket
from collections.abc import Callable, Iterator
from math import inf
from pathlib import Path

from msgspec import structs

from poise.clock import Clock
from poise.errors import Unavailable
from poise.runtime.agent.sampling.watchdog import Silence
from poise.runtime.agent.supervision.back_off import BackOff
from poise.runtime.agent.supervision.container_processes import (
    ContainerProcess,
    ProcessEnd,
)
from poise.runtime.agent.supervision.cpu_weights import CpuWeights, own_group
from poise.runtime.agent.supervision.health import HealthRecords, Usage
from poise.runtime.agent.supervision.oom_kills import OomKills
from poise.runtime.container import zygote
from poise.runtime.hosting.stats_page import new_memory
from poise.wire.records.container import Outcome
from poise.wire.records.deployment import ContainerSpec, Deployment
from poise.wire.records.status import ContainerHealth, ContainerStatus

log = logging.getLogger(__name__)

_OOM_SCORE = 500
_PREPARED_OOM_SCORE = 1000
"""When memory is short, the kernel ends first what is only prepared, then other
containers, and last the agent."""
FENCE_GRACE = 0.5
"""A component that still runs so long after its agent found the lease ended is killed
with its container [s]."""


class Supervisor:
    """The container processes of an agent; for the agent's own thread.

    Parameters
    ----------
    zygote_socket
        The socket of the zygote, from `poise.runtime.container.zygote.start`.
    computer, folder
        The name of the computer, and the folder of the agent.
    awaits
        Returns whether a container of an earlier agent still runs: then it is adopted.
    """

    def __init__(
        self,
        zygote_socket: socket.socket,
        computer: str,
        folder: Path,
        clock: Clock,
        awaits: Callable[[str], bool] = lambda _: False,
    ) -> None:
        self.processes: dict[str, ContainerProcess] = {}
        self.health = HealthRecords()
        self.wanted: Deployment | None = None
        self.cpu_of_ended = 0.0
        self.trouble = ""
        self.lease_end = -inf
        self._is_cut_off = False
        self._cut_off_at = inf
        self._zygote = zygote_socket
        self._computer = computer
        self._folder = folder
        self._clock = clock
        self._backoffs: dict[str, BackOff] = {}
        self._oom_kills = OomKills()
        self.cpu_weights = CpuWeights(own_group())
        self._awaits = awaits
        self._is_ending = False

    @property
    def is_cut_off(self) -> bool:
        """Whether the lease has ended: leased components are to be inactive."""
        return self._is_cut_off

    @is_cut_off.setter
    def is_cut_off(self, is_cut_off: bool) -> None:
        if is_cut_off != self._is_cut_off:
            self._cut_off_at = self._clock.now() if is_cut_off else inf
        self._is_cut_off = is_cut_off

    def extend_lease(self, until: float) -> None:
        """Let leased components act until then [s, CLOCK_BOOTTIME]; on any thread."""
        self.lease_end = until
        for process in list(self.processes.values()):
            if process.lease is not None:
                process.lease.at = until

    def take(self, wanted: Deployment) -> None:
        """Work towards a deployment from now on."""
        self.wanted = wanted
        names = self._specs().keys()
        self._backoffs = {n: b for n, b in self._backoffs.items() if n in names}
        for health in self.health.records({}):
            if health.name not in {*names, *self.processes}:
                self.health.forget(health.name)

    def end(self) -> None:
        """Want no container from now on; repeat `reconcile` until all have ended."""
        self._is_ending = True
        self.take(Deployment(generation=1 << 62, containers=()))

    def reconcile(self) -> None:
        """Take the steps from what runs to what should run."""
        now, wanted = self._clock.now(), self._specs()
        self._oom_kills.look(now)
        for name, process in self.processes.items():
            if name not in wanted and self.wanted is not None:
                process.stop(self._clock)
            process.keep_limits(now)
            self._fence(process, now)
        for name, spec in wanted.items():
            if name in self.processes:
                self._tell(self.processes[name], spec)
            elif name in self._backoffs and now < self._backoffs[name].again_at:
                continue
            elif not self._awaits(name):
                self._start(spec)

    def moments(self) -> Iterator[float]:
        """Yield when something must be done though no news comes [s]."""
        for name in self._specs().keys() & self._backoffs.keys():
            if name not in self.processes:
                yield self._backoffs[name].again_at
        for process in self.processes.values():
            yield min(process.kill_at, process.hung_at)
            if not process.is_deaf and process.leased_at_work(self._cut_off_at):
                yield self._cut_off_at + FENCE_GRACE

    def hear(self, process: ContainerProcess) -> Outcome | None:
        """Take in what a container says; return the outcome of a step, if it is one."""
        outcome = process.hear()
        if process.is_deaf and self.trouble:
            # the zygote would report its end, but there is none
            self._forget(process)
        return outcome

    def hear_zygote(self) -> None:
        """Take in what the zygote says; when it is gone, `trouble` says so."""
        try:
            event = zygote.hear(self._zygote)
        except Unavailable as error:
            # one with threads, as the agent is by now, must not fork another
            self.trouble = f"{error}: no container can be started"
            return
        if isinstance(event, zygote.ContainerEnded):
            self.note_ended(event.pid, ProcessEnd(event.status))
        elif process := self.processes.get(event.name):
            if isinstance(event, zygote.NotForked):
                self._forget(process, event.reason)
                return
            try:
                self._settle(process.spec, event.pid)
                process.note_born(event.pid)
                self.extend_lease(self.lease_end)
            except (OSError, RuntimeError) as error:  # no memory is free
                process.give_up(f"its counters cannot be read: {error}")

    def note_ended(self, pid: int, how: ProcessEnd | str) -> None:
        """Record that the process of a container ended."""
        by_pid = {process.pid: process for process in self.processes.values()}
        if process := by_pid.get(pid):
            process.hear_last()
            self._forget(process, how)

    def adopt(
        self, name: str, pid: int, connection: socket.socket, stats_page: int
    ) -> bool:
        """Take over a container of an earlier agent; return whether that is done.

        It is not when there is another of its name, or no memory is free.
        """
        # it is told what to run, or to end, once that is known
        unknown = ContainerSpec(name=name, folder="", components=(), connectors=())
        process = None
        if name not in self.processes:
            with contextlib.suppress(OSError, RuntimeError):
                process = ContainerProcess(unknown, connection, stats_page, pid)
        if process is None:
            connection.close()
            os.close(stats_page)
            return False
        if name in (specs := self._specs()):  # its group, if there are groups
            self.cpu_weights.nice_of(specs[name])
            self.cpu_weights.settle(specs[name], pid)
        self.health.enter(name, "running")
        self.processes[name] = process
        self.extend_lease(self.lease_end)
        return True

    def note_silence(self, silence: Silence) -> None:
        """Record that a container does not respond, or that it responds again."""
        process = self.processes.get(silence.container)
        if process is None or process.pid != silence.pid or process.is_stopping:
            return
        if process.spec.spare or (process.silence is None and not silence.reason):
            return  # what is prepared may have to wait long for the CPU
        process.silence = silence if silence.reason else None
        process.silent_since = self._clock.now() - silence.seconds
        if silence.reason:
            lasted = f"has not responded for {silence.seconds:.1f} s"
            why = f"{silence.reason}. {silence.remedy}"
            said = f"{lasted}: {why}"
            self.health.enter(silence.container, "unresponsive", why)
        else:
            said = f"responds again, after {silence.seconds:.1f} s"
            self.health.enter(silence.container, "running")
        log.warning("container '%s' %s", silence.container, said)
        self.health.note_fault(silence.container, said, is_over=not silence.reason)

    def statuses(self) -> tuple[ContainerStatus, ...]:
        """Return what the containers said last."""
        return tuple(
            _unresponsive(process.status) if process.silence else process.status
            for process in self.processes.values()
            if process.status is not None
        )

    def records(self, usage: Usage) -> tuple[ContainerHealth, ...]:
        """Return the health of all containers, with what they use now."""
        for name, process in self.processes.items():
            if process.status is not None and process.silence is None:
                self.health.enter(name, "running")
        return self.health.records(usage)

    def _specs(self) -> dict[str, ContainerSpec]:
        containers = self.wanted.containers if self.wanted else ()
        if self.is_cut_off:
            containers = tuple(map(_without_lease, containers))
        return {each.name: each for each in containers}

    def _tell(self, process: ContainerProcess, spec: ContainerSpec) -> None:
        if process.is_stopping:
            return
        if process.pid and process.spec.spare != spec.spare:
            self._settle(spec, process.pid)
        process.tell(spec)

    def _fence(self, process: ContainerProcess, now: float) -> None:
        """Kill a container whose code goes on though it has no lease any more."""
        if now < self._cut_off_at + FENCE_GRACE or process.is_deaf:
            return
        if at_work := process.leased_at_work(self._cut_off_at):
            names = ", ".join(f"'{name}'" for name in at_work)
            process.give_up(
                f"{names} still ran {FENCE_GRACE:g} s after the computer's lease ended"
            )

    def _settle(self, spec: ContainerSpec, pid: int) -> None:
        """Give a process what its container is to have of the computer."""
        self.cpu_weights.settle(spec, pid)
        with contextlib.suppress(OSError):  # it has ended
            score = _PREPARED_OOM_SCORE if spec.spare else _OOM_SCORE
            Path(f"/proc/{pid}/oom_score_adj").write_text(str(score))

    def _start(self, spec: ContainerSpec) -> None:
        with contextlib.ExitStack() as undo:
            try:
                memory = new_memory()
                undo.callback(os.close, memory)
                wanted = zygote.Fork(
                    name=spec.name,
                    computer=self._computer,
                    folder=os.fspath(self._folder),
                    nice=self.cpu_weights.nice_of(spec),
                )
                connection = zygote.ask(self._zygote, wanted, memory)
            except Unavailable:
                return  # the zygote's end is heard next, and is the end of the agent
            except OSError as error:  # no descriptor or memory is free at the moment
                self._note_end(spec.name, f"cannot be started: {error}")
                return
            undo.pop_all()
        self.health.note_start(spec.name)
        self.processes[spec.name] = ContainerProcess(spec, connection, memory)

    def _forget(
        self, process: ContainerProcess, how: ProcessEnd | str = "ended"
    ) -> None:
        """Record a container's end, so that it can be started again later."""
        del self.processes[process.name]
        process.close()
        self.cpu_weights.forget(process.name)
        self.cpu_of_ended += process.status.cpu if process.status else 0.0
        if process.is_stopping or self._is_ending:
            if process.name not in self._specs():
                self.health.forget(process.name)
            return
        if process.may_be_oom(how) and self._oom_kills.claim(self._clock.now()):
            how = (
                "was killed because its computer ran out of memory (OOM)"
                f"{self._oom_kills.limit()}: give the computer more, or move "
                "components to another"
            )
        parts = [str(how), process.last_error(), process.loss(self._folder)]
        said = "; ".join(filter(None, parts))
        self._note_end(process.name, said)

    def _note_end(self, container: str, said: str) -> None:
        log.warning("container '%s' %s", container, said)
        self.health.note_fault(container, said)
        self.health.enter(container, "restarting")
        backoff = self._backoffs.setdefault(container, BackOff())
        backoff.note_end(self._clock.now(), random.uniform(0.5, 1))  # noqa: S311, jitter


def _without_lease(spec: ContainerSpec) -> ContainerSpec:
    """Return a container whose leased components are inactive, with their state."""
    return structs.replace(
        spec,
        components=tuple(
            structs.replace(component, goal="inactive")
            if component.leased
            else component
            for component in spec.components
        ),
    )


def _unresponsive(status: ContainerStatus) -> ContainerStatus:
    """Return a status that does not say of its components that they are at work."""
    components = tuple(
        structs.replace(component, state="unresponsive")
        if component.state == "active"
        else component
        for component in status.components
    )
    return structs.replace(status, components=components)
