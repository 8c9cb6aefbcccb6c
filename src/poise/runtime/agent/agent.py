"""The agent: on each computer, the program that runs its containers.

It compares what should run with what runs and takes the smallest step. A container that
ended is "not running" and is started again after a delay that grows. It goes on running
what it has when the manager is gone. One thread owns all of it; zenoh's threads only
hand over what came.
"""

from __future__ import annotations

import logging
import os
import random
import signal
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FrameType

import msgspec
import zenoh
from msgspec import Struct

from poise.clock import Clock, SystemClock
from poise.endpoint import Endpoint
from poise.errors import RunError, Unavailable, UsageError
from poise.priority import go_first
from poise.runtime._calls import Reader
from poise.runtime.agent.clock_synchronisation import ClockSynchronisation
from poise.runtime.agent.container_processes import (
    STOP_LIMIT,
    BackOff,
    ContainerProcess,
    End,
)
from poise.runtime.agent.fence import Fence
from poise.runtime.agent.inbox import AgentInbox, answer
from poise.runtime.agent.migration_relay import MigrationRelay
from poise.runtime.agent.sampler import Sampler
from poise.runtime.container import zygote
from poise.runtime.hosting.stats_page import new_memory
from poise.runtime.hosting.wiring import Place
from poise.runtime.waker import Waker, wait_readable
from poise.wire.connections.gateway import Gateway
from poise.wire.connections.socket_path import socket_path
from poise.wire.control_session import locator, open_session
from poise.wire.records.clocks import ClockStatus
from poise.wire.records.deployment import (
    Accepted,
    AgentStatus,
    Claim,
    ContainerSpec,
    Deployment,
    Fault,
    ManagerRequest,
    Refused,
)
from poise.wire.records.migration import Failed, Order
from poise.wire.records.samples import SAMPLE_EVERY

log = logging.getLogger(__name__)

REPORT_EVERY = 0.5
"""A status goes out at least this often [s]."""
_MOST_FAULTS = 100


class AgentSetup(Struct, frozen=True, kw_only=True):
    """Where an agent is and whom it knows.

    Parameters
    ----------
    robot, computer
        Names.
    address
        IP address on which it and its containers listen.
    port
        TCP port of the agent.
    gateway
        TCP port at which links to its containers come in; 0: one that is free.
    peers
        zenoh endpoints of the other computers' agents.
    folder
        A folder of its own for sockets.
    lifeline
        A file descriptor at whose end of file the agent ends; None: it runs on.
    sample_every
        How often it tells what its containers count [s]; 0: never.
    """

    robot: str
    computer: str
    address: str
    port: int = 7447
    gateway: int = 0
    peers: tuple[str, ...] = ()
    folder: str
    lifeline: int | None = None
    sample_every: float = SAMPLE_EVERY


class Agent:
    """Runs the containers of one computer.

    Raises
    ------
    UsageError
        The path of the folder is too long for sockets in it.
    """

    def __init__(self, setup: AgentSetup, clock: Clock | None = None) -> None:
        self._setup = setup
        self._clock = clock or SystemClock()
        self._born = self._clock.now()
        self._wanted: Deployment | None = None
        self._children: dict[str, ContainerProcess] = {}
        self._backoffs: dict[str, BackOff] = {}
        self._faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)
        self._cpu_of_ended = 0.0
        self._stopping = False
        self._trouble = ""
        self._gateway = ""
        self._clocks: Callable[[], Mapping[str, ClockStatus]] = dict
        self._orders = MigrationRelay(self._children)
        try:
            socket_path(Path(setup.folder), "")
        except ValueError as error:
            raise UsageError(f"folder of agent '{setup.computer}': {error}") from error
        Path(setup.folder).mkdir(parents=True, exist_ok=True)
        # before any thread, zenoh session or descriptor of the agent's own exists
        held = () if setup.lifeline is None else (setup.lifeline,)
        self._zygote, self._zygote_pid = zygote.start(closing=held)
        self._waker = Waker()
        self._requests = AgentInbox(setup.computer, self._waker.wake)
        self._fence = Fence(setup.robot, setup.computer)

    def run(self) -> None:
        """Work until asked to end by a signal or by the end of the lifeline.

        Raises
        ------
        RunError
            It cannot listen at its address, or the zygote ended.
        """
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)
        # all of its threads alike: they share an interpreter
        go_first()
        try:
            self._run_in(self._setup)
        finally:
            zygote.end(self._zygote, self._zygote_pid)
        if self._trouble:
            raise RunError(f"agent '{self._setup.computer}': {self._trouble}")

    def _run_in(self, setup: AgentSetup) -> None:
        prefix = f"poise/{setup.robot}"
        # beside its manager it is never cut off, but may have to wait for its turn
        lease = 1.0 if setup.lifeline is None else 10.0
        with (
            Gateway(Path(setup.folder), setup.address, setup.gateway) as gateway,
            open_session(
                listen=[locator(Endpoint(setup.address, setup.port))],
                connect=setup.peers,
                lease=lease,
            ) as session,
        ):
            self._gateway = str(gateway)
            publisher = session.declare_publisher(f"{prefix}/status/{setup.computer}")
            key = f"{prefix}/agent/{setup.computer}"
            answers = session.declare_queryable(key, self._requests.hear)
            managers = session.liveliness().declare_subscriber(
                f"{prefix}/manager/*", self._fence.note_liveliness, history=True
            )
            token = session.liveliness().declare_token(
                f"{prefix}/alive/{setup.computer}"
            )
            samples = session.declare_publisher(f"{prefix}/samples/{setup.computer}")
            collector = self._collector(samples)
            clocks = ClockSynchronisation(
                session, prefix, setup.computer, Path(setup.folder), self._clock
            )
            try:
                if setup.sample_every:
                    collector.start()
                clocks.start()
                self._clocks = clocks.known
                self._serve(publisher)
            finally:
                clocks.stop()
                collector.stop()
                managers.undeclare()  # type: ignore[no-untyped-call]
                answers.undeclare()  # type: ignore[no-untyped-call]
                self._end_all()
                token.undeclare()  # type: ignore[no-untyped-call]

    def _collector(self, samples: zenoh.Publisher) -> Sampler:
        def containers() -> list[tuple[str, int, Reader]]:
            children = list(self._children.values())
            return [(c.name, c.pid, c.counted) for c in children if c.counted]

        every = self._setup.sample_every
        return Sampler(self._setup.computer, every, containers, samples.put)

    def _on_signal(self, _signal: int, _frame: FrameType | None) -> None:
        self._stopping = True
        self._waker.wake()

    def _attend(self, asked: ManagerRequest, query: zenoh.Query) -> None:
        request, refusal = asked.request, self._fence.refusal(asked.token)
        if isinstance(request, Claim):
            answer(query, self._fence.claim(request, asked.token))
        elif isinstance(request, Order):
            if refusal:
                answer(query, Failed(request.number, refusal))
            else:
                self._orders.carry(request, query, self._clock.now())
        elif refusal:
            answer(query, Refused(refusal))
        elif self._wanted and request.generation < self._wanted.generation:
            older = f"generation {request.generation} is older than "
            answer(query, Refused(f"{older}{self._wanted.generation}"))
        else:
            self._take(request)
            answer(query, Accepted())

    def _serve(self, publisher: zenoh.Publisher) -> None:
        report_at, reported = 0.0, _states(self._status())
        while not self._stopping:
            self._wait(report_at)
            for request, query in self._requests.take():
                self._attend(request, query)
            self._orders.give_up(self._clock.now())
            self._reconcile()
            status = self._status()
            seen = _states(status)
            if seen != reported or self._clock.now() >= report_at:
                publisher.put(msgspec.msgpack.encode(status))
                report_at, reported = self._clock.now() + REPORT_EVERY, seen

    def _wait(self, until: float) -> None:
        """Wait for news until some moment [s], and take them in."""
        children = [c for c in self._children.values() if not c.is_deaf]
        by_fd = {child.connection.fileno(): child for child in children}
        zygote_fd, lifeline = self._zygote.fileno(), self._setup.lifeline
        fixed = [self._waker.fileno()]
        fixed += [] if self._trouble else [zygote_fd]
        fixed += [] if self._stopping or lifeline is None else [lifeline]
        limit = max(0.0, min([until, *self._moments()]) - self._clock.now())
        for fd in wait_readable([*fixed, *by_fd], limit):
            if fd in by_fd:
                self._hear(by_fd[fd])
            elif fd == self._waker.fileno():
                self._waker.clear()
            elif fd == zygote_fd:
                self._hear_zygote()
            else:
                self._stopping = True

    def _moments(self) -> list[float]:
        """Return when something must be done though nobody says anything [s]."""
        starts = [b.again_at for n, b in self._backoffs.items() if self._is_due(n)]
        kills = [child.kill_at for child in self._children.values()]
        return [*starts, *self._orders.limits(), *kills]

    def _is_due(self, name: str) -> bool:
        wanted = self._wanted.containers if self._wanted else ()
        return name not in self._children and name in {spec.name for spec in wanted}

    def _hear(self, child: ContainerProcess) -> None:
        outcome = child.hear()
        if outcome is not None:
            self._orders.end(outcome)
        if child.is_deaf and self._trouble:
            # the zygote would tell when it ended, but there is none
            self._forget(child)

    def _hear_zygote(self) -> None:
        try:
            event = zygote.hear(self._zygote)
        except Unavailable as error:
            # one with threads, as the agent is by now, must not fork another
            self._trouble = f"{error}: no container can be started"
            self._stopping = True
            return
        if isinstance(event, zygote.Ended):
            by_pid = {child.pid: child for child in self._children.values()}
            if event.pid in by_pid:
                self._forget(by_pid[event.pid], str(End(event.status)))
        elif child := self._children.get(event.name):
            if isinstance(event, zygote.Forked):
                child.note_born(event.pid)
            else:
                self._forget(child, event.reason)

    def _forget(self, child: ContainerProcess, how: str = "ended") -> None:
        """Take note of a container's end, so that it can be started again later."""
        del self._children[child.name]
        child.close()
        self._cpu_of_ended += child.status.cpu if child.status else 0.0
        if child.is_stopping or self._stopping:
            return
        said = "; ".join(part for part in (how, child.last_error()) if part)
        log.warning("container '%s' %s", child.name, said)
        self._faults.append(Fault(container=child.name, message=said))
        backoff = self._backoffs.setdefault(child.name, BackOff())
        backoff.note_end(self._clock.now(), random.uniform(0.5, 1))  # noqa: S311, jitter

    def _take(self, wanted: Deployment) -> None:
        if self._wanted is None or not self._wanted.containers:
            self._faults.clear()  # of an earlier run
        self._wanted = wanted
        names = {spec.name for spec in wanted.containers}
        self._backoffs = {n: b for n, b in self._backoffs.items() if n in names}

    def _reconcile(self) -> None:
        """Take the steps from what runs to what should run."""
        wanted = {c.name: c for c in self._wanted.containers} if self._wanted else {}
        now = self._clock.now()
        for name, child in self._children.items():
            if name not in wanted:
                child.stop(self._clock)
            if child.kill_at <= now:
                child.kill()
        for name, spec in wanted.items():
            if name in self._children:
                if not self._children[name].is_stopping:
                    self._children[name].tell(spec)
            elif name not in self._backoffs or self._backoffs[name].is_over(now):
                self._start(spec)

    def _start(self, spec: ContainerSpec) -> None:
        memory = new_memory()
        try:
            place = self._place(spec.name)
            connection = zygote.ask(self._zygote, spec.name, memory, place)
        except Unavailable:
            os.close(memory)
            return  # the zygote's end is heard next, and is the end of the agent
        self._children[spec.name] = ContainerProcess(spec, connection, memory)

    def _place(self, name: str) -> Place:
        return Place(
            container=name,
            folder=self._setup.folder,
            gateway=self._gateway,
            computer=self._setup.computer,
        )

    def _status(self) -> AgentStatus:
        statuses = [c.status for c in self._children.values() if c.status is not None]
        used = time.process_time() + self._cpu_of_ended + sum(s.cpu for s in statuses)
        return AgentStatus(
            computer=self._setup.computer,
            generation=self._wanted.generation if self._wanted else 0,
            token=self._fence.token,
            manager=self._fence.manager,
            uptime=self._clock.now() - self._born,
            cpu=used,
            gateway=self._gateway,
            containers=tuple(statuses),
            faults=tuple(self._faults),
            clocks=self._clocks(),
        )

    def _end_all(self) -> None:
        """End every container in stages."""
        self._stopping = True
        self._wanted = Deployment(generation=1 << 62, containers=())
        self._reconcile()
        limit = self._clock.now() + STOP_LIMIT + 1
        while self._children and self._clock.now() < limit:
            self._wait(self._clock.now() + 0.1)
            self._reconcile()
        for child in self._children.values():
            child.kill()


def _states(status: AgentStatus) -> tuple[object, ...]:
    """Return the part of a status whose change is told at once."""
    components = [
        (component.name, component.state, component.errors)
        for container in status.containers
        for component in container.components
    ]
    connectors = [
        (connector.name, connector.ready)
        for container in status.containers
        for connector in container.connectors
    ]
    found = (status.generation, status.token, len(status.faults))
    return (*found, components, connectors)
