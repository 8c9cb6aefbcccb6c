"""Starts, watches and ends the containers of one computer.

It takes the smallest step from those that run to those that should. One that ended is
started again after a delay that grows. An error in handling one stops no other.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from functools import cache
from math import inf
from random import Random

from msgspec import structs

from poise.clock import Clock
from poise.errors import Unavailable
from poise.runtime.agent.inbox import SupervisedParts
from poise.runtime.agent.surroundings import ContainerControl, ContainerHost
from poise.runtime.supervision.container_processes import ContainerProcess, ProcessEnd
from poise.runtime.supervision.health import HealthRecords, Silence, Usage
from poise.threads import BackOff, without_process
from poise.wire.records.deployment_records import ContainerSpec, Deployment
from poise.wire.records.heartbeat_records import Clocks
from poise.wire.records.status_records import (
    ContainerAnswer,
    ContainerFailure,
    ContainerHealth,
    ContainerStatus,
    FromContainer,
)

log = logging.getLogger(__name__)

FENCE_GRACE = 0.5
"""A component that still runs so long after its agent found the lease ended is killed
with its container [s]."""


class Supervisor:
    """The containers of an agent; for the agent's own thread."""

    def __init__(
        self,
        host: ContainerHost,
        clock: Clock,
        supervised: SupervisedParts,
        health: HealthRecords,
        random: Random,
        awaits: Callable[[str], bool],
        checkpoint_age: Callable[[str, int], float | None],
    ) -> None:
        self.processes: dict[str, ContainerProcess] = {}
        self.health = health
        self.wanted: Deployment | None = None
        self.cpu_of_ended = 0.0
        self.trouble = ""
        self.lease_end = -inf
        self.is_cut_off = False
        self._is_left = False
        self._cut_off_at = inf
        self._host = host
        self._clock = clock
        self._supervised = supervised
        self._random = random
        self._awaits = awaits
        self._checkpoint_age = checkpoint_age
        self._backoffs: dict[str, BackOff] = {}
        self._is_ending = False

    def note_cut_off(self, *, is_cut_off: bool) -> None:
        """Take in whether the lease has ended: leased components are to be inactive."""
        if is_cut_off != self.is_cut_off:
            self._cut_off_at = self._clock.now() if is_cut_off else inf
        self.is_cut_off = is_cut_off

    def extend_lease(self, until: float) -> None:
        """Let leased components act until then [s, CLOCK_BOOTTIME]; on any thread."""
        self.lease_end = until
        containers = self.wanted.containers if self.wanted else ()
        wanted = {container.name: container for container in containers}
        for process in list(self.processes.values()):
            if (
                until == -inf
                or not process.is_fenced()
                or process.runs_only(wanted.get(process.name))
            ):
                process.control.extend_lease(until)

    def deploy(self, wanted: Deployment, *, is_left: bool = False) -> None:
        """Work towards a deployment from now on.

        `is_left`: an earlier agent left it on its disk, which may be late. Containers
        that go on know better, and what starts may run elsewhere by now.
        """
        if self.wanted and self.wanted.is_last and not wanted.is_last:
            self.health.forget_stopped()
        self.wanted, self._is_left = wanted, is_left
        names = self._specs().keys()
        self._backoffs = {n: b for n, b in self._backoffs.items() if n in names}
        for health in self.health.records({}):
            if health.name not in {*names, *self.processes}:
                self.health.forget(health.name)

    def end(self) -> None:
        """Want no container from now on; repeat `reconcile` until all have ended."""
        self._is_ending = True
        self.deploy(Deployment(generation=1 << 62, containers=()))

    def reconcile(self) -> None:
        """Take the steps from the running containers to the deployment."""
        now, wanted = self._clock.now(), self._specs()
        self._supervised.run("count of OOM kills", self._host.count_kills, now)
        for name in {**self.processes, **wanted}:
            self._supervised.run(part_of(name), self._step, name, wanted.get(name))

    def send_clocks(self, clocks: Clocks) -> None:
        """Tell all containers what is known of other computers."""
        for name, process in self.processes.items():
            self._supervised.run(part_of(name), process.send_clocks, clocks)

    def moment(self) -> float:
        """Return when something must be done though no news comes [s]."""
        return min(self._moments(), default=float("inf"))

    def is_heard(self, container: str) -> bool:
        """Return whether what a container says is to be read now."""
        process = self.processes.get(container)
        is_resting = self._supervised.is_resting(part_of(container))
        return process is not None and not process.is_deaf and not is_resting

    def is_news(self, container: str, record: FromContainer) -> bool:
        """Return whether what a container says changes what a tick does."""
        if isinstance(record, ContainerAnswer):
            return False
        process = self.processes.get(container)
        before = None if process is None else process.status
        return (
            before is None
            or not isinstance(record, ContainerStatus)
            or record.states != before.states
            or record.missed != before.missed
        )

    def note(self, container: str, record: FromContainer) -> ContainerAnswer | None:
        """Take in what a container says; return the outcome of a step, if it is one."""
        process = self.processes.get(container)
        if isinstance(record, ContainerFailure) and record.goes_on:
            self.health.note_fault(container, record.reason)
            return None
        return None if process is None else process.note(record)

    def note_deaf(self, container: str, why: str) -> None:
        """Kill a container that cannot be heard any more, and record why."""
        process = self.processes.get(container)
        if process is not None:
            process.give_up(why)
            if self.trouble and not process.pid:
                self._forget(process)  # nobody would report its end

    def note_born(self, container: str, pid: int) -> None:
        """Record that the process of a container began."""
        process = self.processes.get(container)
        if process is not None:
            try:
                self._host.settle(process.spec, pid)
                process.note_born(pid)
                self.extend_lease(self.lease_end)
            except (OSError, RuntimeError) as error:  # no memory is free
                process.give_up(f"its counters cannot be read: {error}")

    def note_not_born(self, container: str, why: str) -> None:
        """Record that the process of a container could not begin."""
        process = self.processes.get(container)
        if process is not None:
            self._forget(process, why)

    def note_ended(self, pid: int, how: ProcessEnd | str) -> None:
        """Record that the process of a container ended."""
        name = self.name_of(pid)
        if name:
            self._forget(self.processes[name], how)

    def unwanted_of(self, pid: int) -> set[tuple[str, int]]:
        """Return what a process runs that is not to run here; see `incarnations`."""
        name = self.name_of(pid)
        if not name or self.wanted is None:
            return set()
        wanted = {c.key for c in self.wanted.components}
        return self.processes[name].incarnations() - wanted

    def name_of(self, pid: int) -> str:
        """Return the container of a process; empty: it is of none."""
        names = (p.name for p in self.processes.values() if p.pid == pid)
        return next(names, "")

    def adopt(self, name: str, pid: int, control: ContainerControl) -> bool:
        """Take over a container of an earlier agent; return whether that is done."""
        if name in self.processes:
            return False
        # it is told what to run, or to end, once that is known
        unknown = ContainerSpec(name=name, folder="", components=(), connectors=())
        try:
            process = ContainerProcess(unknown, control, pid)
        except (OSError, RuntimeError):
            return False
        if name in (specs := self._specs()):
            self._host.settle(specs[name], pid)
        self.health.enter(name, "running")
        self.processes[name] = process
        self.extend_lease(self.lease_end)
        return True

    def note_silence(self, silence: Silence) -> None:
        """Record that a container does not respond, or that it responds again."""
        process = self.processes.get(silence.container)
        if process is None or process.pid != silence.pid or process.is_stopping:
            return
        if process.spec.preparation_cpu or (
            process.silence is None and not silence.reason
        ):
            return  # what is prepared may have to wait long for the CPU
        process.silence = silence if silence.reason else None
        process.silent_since = self._clock.now() - silence.seconds
        if silence.reason:
            lasted = f"has not responded for {silence.seconds:.1f} s"
            why = f"{silence.reason}. {silence.remedy}"
            message = f"{lasted}: {why}"
            self.health.enter(silence.container, "unresponsive", why)
        else:
            message = f"responds again, after {silence.seconds:.1f} s"
            self.health.enter(silence.container, "running")
        log.warning("container '%s' %s", silence.container, message)
        self.health.note_fault(silence.container, message, is_over=not silence.reason)

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
        if self.is_cut_off or self._is_left:
            containers = tuple(container.without_lease() for container in containers)
        return {container.name: container for container in containers}

    def _moments(self) -> Iterator[float]:
        again_at = self._supervised.again_at
        for name in sorted(self._specs().keys() & self._backoffs.keys()):
            if name not in self.processes and not self.trouble:
                yield max(self._backoffs[name].again_at, again_at(part_of(name)))
        for name, process in self.processes.items():
            due = min(process.kill_at, process.hung_at)
            if not process.is_deaf and process.leased_at_work(self._cut_off_at):
                due = min(due, self._cut_off_at + FENCE_GRACE)
            yield max(due, again_at(part_of(name)))

    def _step(self, name: str, spec: ContainerSpec | None) -> None:
        now, process = self._clock.now(), self.processes.get(name)
        if process is not None:
            knows_better = self._is_left and process.is_adopted
            if spec is None and self.wanted is not None and not knows_better:
                process.stop(now)
            process.keep_limits(now)
            self._fence(process, now)
            if spec is not None and (self.is_cut_off or not knows_better):
                self._tell(process, spec)
        elif spec is not None and not self._awaits(name):
            backoff = self._backoffs.get(name)
            if self.trouble:
                why = f"cannot be started: {self.trouble}"
                self.health.enter(name, "restarting", why)
            elif backoff is None or now >= backoff.again_at:
                self._start(spec)

    def _tell(self, process: ContainerProcess, spec: ContainerSpec) -> None:
        if process.is_stopping:
            return
        cpus = [(s.preparation_cpu, s.weight) for s in (process.spec, spec)]
        if process.pid and cpus[0] != cpus[1]:
            self._host.settle(spec, process.pid)
        process.deploy(spec)

    def _fence(self, process: ContainerProcess, now: float) -> None:
        """Kill a container whose code goes on though it has no lease any more."""
        if now < self._cut_off_at + FENCE_GRACE or process.is_deaf:
            return
        if at_work := process.leased_at_work(self._cut_off_at):
            names = ", ".join(f"'{name}'" for name in at_work)
            process.give_up(
                f"{names} still ran {FENCE_GRACE:g} s after the computer's lease ended"
            )

    def _start(self, spec: ContainerSpec) -> None:
        try:
            control = self._host.start(spec)
        except Unavailable:
            return  # the reason is heard next
        except OSError as error:  # no descriptor or memory is free at the moment
            why = without_process(error)
            self._note_end(spec.name, why, why)
            return
        self.health.note_start(spec.name)
        self.processes[spec.name] = ContainerProcess(spec, control)

    def _forget(
        self, process: ContainerProcess, how: ProcessEnd | str = "ended"
    ) -> None:
        """Record a container's end, so that it can be started again later."""
        del self.processes[process.name]
        process.control.close()
        self._host.release(process.name)
        self.cpu_of_ended += process.status.cpu if process.status else 0.0
        if process.is_stopping or self._is_ending:
            if why := process.why_late:
                self.health.note_fault(process.name, f"was ended: {why}")
            if process.name not in self._specs():
                self.health.forget(process.name)
            return
        if process.may_be_oom(how):
            how = self._host.explain_kill(self._clock.now()) or how
        loss = process.loss(self._checkpoint_age)
        parts = [str(how), process.last_error(), loss]
        message = "; ".join(filter(None, parts))
        self._note_end(process.name, message, "" if process.pid else message)

    def _note_end(self, container: str, message: str, why_none: str) -> None:
        """Record an end; `why_none`: why there was not even a process, else empty."""
        log.warning("container '%s' %s", container, message)
        self.health.note_fault(container, message)
        self.health.enter(container, "restarting", why_none)
        backoff = self._backoffs.setdefault(container, BackOff())
        backoff.note_end(self._clock.now(), self._random.uniform(0.5, 1))


@cache
def part_of(container: str) -> str:
    """Return the name of what an agent does for a container, for `SupervisedParts`."""
    return f"container '{container}'"


def _unresponsive(status: ContainerStatus) -> ContainerStatus:
    """Return a status that does not say of its components that they are at work."""
    components = tuple(
        structs.replace(component, state="unresponsive")
        if component.state == "active"
        else component
        for component in status.components
    )
    return structs.replace(status, components=components)
