"""The agent: on each computer, the program that runs its containers.

It takes requests from the manager, lets its supervisor run the containers, and reports
their status. When the manager is gone the containers go on. When the agent is killed
they go on, too, and the next agent in the same folder adopts them. One thread owns all
of this; zenoh's threads only queue requests.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import FrameType

import zenoh
from msgspec.msgpack import encode

from poise.clock import SystemClock
from poise.endpoint import Endpoint
from poise.errors import RunError, UsageError
from poise.priority import ahead, go_first
from poise.runtime._calls import PageSampler
from poise.runtime.agent.agent_setup import AgentSetup
from poise.runtime.agent.checkpoint_files import CheckpointFiles
from poise.runtime.agent.fence import Fence
from poise.runtime.agent.heartbeat_exchange import HeartbeatExchange
from poise.runtime.agent.inbox import AgentInbox, answer
from poise.runtime.agent.sampling.sampler import Sampler
from poise.runtime.agent.sampling.watchdog import Silence
from poise.runtime.agent.status_reports import StatusReports
from poise.runtime.agent.supervision.adoption import (
    ADOPT_LIMIT,
    AdoptedContainers,
    AgentFolder,
)
from poise.runtime.agent.supervision.agent_state import AgentState
from poise.runtime.agent.supervision.container_processes import STOP_LIMIT
from poise.runtime.agent.supervision.health import Usage
from poise.runtime.agent.supervision.migration_relay import MigrationRelay
from poise.runtime.agent.supervision.supervisor import Supervisor
from poise.runtime.container import zygote
from poise.runtime.container.descendants import kill_all
from poise.runtime.hosting.output import forget_output, read_output
from poise.runtime.waker import Waker, wait_readable
from poise.wire.connections.gateway import Gateway
from poise.wire.connections.socket_path import socket_path
from poise.wire.control_session import identity_key, locator, open_session
from poise.wire.records.checkpoints import CheckpointCopy
from poise.wire.records.container import Order
from poise.wire.records.deployment import Deployment
from poise.wire.records.migration import StepsFailed
from poise.wire.records.output import ReadOutput
from poise.wire.records.requests import (
    PROTOCOL,
    Accepted,
    Answer,
    Claim,
    Claimed,
    ManagerRequest,
    Refused,
)
from poise.wire.records.status import AgentStatus

log = logging.getLogger(__name__)


class Agent:
    """Runs the containers of one computer.

    Parameters
    ----------
    say
        Called with a sentence when it has begun to listen, and when a manager comes or
        goes; on the agent's own thread.

    Raises
    ------
    UsageError
        The path of the folder is too long for sockets in it, or another agent uses it.
    """

    def __init__(self, setup: AgentSetup, say: Callable[[str], object]) -> None:
        self._setup = setup
        self._clock = SystemClock()
        self._born = self._clock.now()
        self._stopping = False
        self._trouble: Callable[[], str] = str
        self._usage: Callable[[], Usage] = dict
        try:
            socket_path(Path(setup.folder), "")
        except ValueError as error:
            raise UsageError(f"folder of agent '{setup.computer}': {error}") from error
        folder = Path(setup.folder)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._folder = AgentFolder(folder)
        left = self._folder.left()
        self._gateway = left.gateway
        # before any thread, zenoh session or descriptor of the agent's own exists
        held = () if setup.lifeline is None else (setup.lifeline,)
        self._zygote, self._zygote_pid = zygote.start(closing=held)
        self._adoption = AdoptedContainers(folder, self._clock)
        self._supervisor = Supervisor(
            self._zygote, setup.computer, folder, self._clock, self._adoption.awaits
        )
        if left.wanted is not None:
            self._supervisor.take(left.wanted)
        self._relay = MigrationRelay(self._supervisor.processes)
        self._waker = Waker()
        self._inbox = AgentInbox(setup.computer, self._attend, self._waker.wake)
        self._fence = Fence(
            setup.robot,
            setup.computer,
            self._waker.wake,
            say,
            left.manager,
            left.token,
        )
        self._agents_before = left.agents, left.is_leased
        self._endpoint = Endpoint(setup.address, setup.port)
        self._locator = locator(self._endpoint)
        self._heartbeats: HeartbeatExchange
        self._say = say

    def run(self) -> None:
        """Work until asked to end by a signal or by the end of the lifeline.

        Raises
        ------
        RunError
            It cannot listen at its address, or the zygote ended.
        """
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            if signal.getsignal(number) != signal.SIG_IGN:  # as under `nohup`
                signal.signal(number, self._on_signal)
        try:
            with ahead():  # zenoh's threads inherit that
                self._run_in(self._setup)
        finally:
            zygote.end(self._zygote, self._zygote_pid)
        if trouble := self._supervisor.trouble:
            raise RunError(f"agent '{self._setup.computer}': {trouble}")

    def _run_in(self, setup: AgentSetup) -> None:
        prefix = f"poise/{setup.robot}"
        with (
            self._open_gateway() as gateway,
            open_session(listen=[self._locator], lease=setup.lease) as session,
        ):
            self._gateway, self._trouble = str(gateway), gateway.warning.trouble
            self._say(
                f"agent of computer '{setup.computer}' of robot '{setup.robot}' at "
                f"{self._locator.removeprefix('tcp/')}, gateway {gateway}; "
                f"Poise {version('poise')}, protocol {PROTOCOL}"
            )
            publisher = session.declare_publisher(f"{prefix}/status/{setup.computer}")
            key = f"{prefix}/agent/{setup.computer}"
            answers = session.declare_queryable(key, self._inbox.hear)
            managers = session.liveliness().declare_subscriber(
                f"{prefix}/manager/*", self._fence.note_liveliness, history=True
            )
            tokens: list[zenoh.LivelinessToken] = []

            def appear() -> None:
                tokens.extend(
                    session.liveliness().declare_token(key)
                    for key in (
                        f"{prefix}/alive/{setup.computer}",
                        identity_key(self._locator, setup.robot, setup.computer),
                    )
                )

            samples = session.declare_publisher(f"{prefix}/samples/{setup.computer}")
            copies = session.declare_publisher(
                f"{prefix}/checkpoint/{setup.computer}",
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.BACKGROUND,
            )
            checkpoints = self._checkpoints = CheckpointFiles(
                Path(setup.folder), lambda copy: copies.put(encode(copy))
            )
            if self._supervisor.wanted is not None:
                checkpoints.keep_only(self._supervisor.wanted)
            sampler = self._sampler(samples)
            heartbeats = self._heartbeats = HeartbeatExchange(
                setup.robot, setup.computer, self._endpoint, self._fence, self._clock
            )
            heartbeats.begin_again(*self._agents_before)
            go_first()
            try:
                sampler.start()
                self._usage = sampler.usage
                checkpoints.start()
                self._serve(publisher, appear)
            finally:
                heartbeats.close()
                checkpoints.stop()
                sampler.stop()
                managers.undeclare()  # type: ignore[no-untyped-call]
                answers.undeclare()  # type: ignore[no-untyped-call]
                self._end_all()
                for token in tokens:
                    token.undeclare()  # type: ignore[no-untyped-call]

    def _open_gateway(self) -> Gateway:
        """Open it where the agent before had it, so that connectors find it again."""
        folder, setup = Path(self._setup.folder), self._setup
        before = Endpoint.parse(self._gateway).port if self._gateway else 0
        if before and not setup.gateway:
            with contextlib.suppress(RunError):  # the port is another's now
                return Gateway(folder, setup.address, before)
        return Gateway(folder, setup.address, setup.gateway)

    def _keep_state(self) -> None:
        self._folder.keep(
            AgentState(
                gateway=self._gateway,
                manager=self._fence.manager,
                token=self._fence.token,
                wanted=self._supervisor.wanted,
                agents=self._heartbeats.agents,
                is_leased=self._heartbeats.is_leased,
            )
        )

    def _sampler(self, samples: zenoh.Publisher) -> Sampler:
        def containers() -> list[tuple[str, int, PageSampler]]:
            processes = list(self._supervisor.processes.values())
            return [(p.name, p.pid, p.counted) for p in processes if p.counted]

        def on_silence(silence: Silence) -> None:
            self._inbox.put(partial(self._supervisor.note_silence, silence))

        every, computer = self._setup.sample_every, self._setup.computer
        return Sampler(computer, every, containers, samples.put, on_silence)

    def _on_signal(self, _signal: int, _frame: FrameType | None) -> None:
        self._stopping = True
        self._waker.wake()

    def _attend(self, asked: ManagerRequest, query: zenoh.Query) -> None:
        request, refusal = asked.request, self._fence.refusal(asked.token)
        wanted = self._supervisor.wanted
        if isinstance(request, Claim):
            refused = self._fence.claim(request, asked.token)
            if refused is None:
                self._heartbeats.begin(
                    request.manager.key, request.agents, is_leased=request.is_leased
                )
                self._checkpoints.resend()
            answer(query, refused or Claimed(wanted))
        elif isinstance(request, Order):
            if refusal:
                answer(query, StepsFailed(request.number, refusal))
            else:
                self._relay.pass_on(request, query, self._clock.now())
        elif refusal:
            answer(query, Refused(refusal))
        elif isinstance(request, ReadOutput | CheckpointCopy):
            answer(query, self._use_folder(request))
        elif wanted and request.generation < wanted.generation:
            older = f"generation {request.generation} is older than "
            answer(query, Refused(f"{older}{wanted.generation}"))
        else:
            self._supervisor.take(request)
            self._fence.note_told()
            self._checkpoints.keep_only(request)
            answer(query, Accepted())

    def _use_folder(self, request: ReadOutput | CheckpointCopy) -> Answer:
        try:
            if isinstance(request, ReadOutput):
                return read_output(Path(self._setup.folder), request)
            self._checkpoints.write(request)
        except OSError as error:
            return Refused(f"it cannot use its folder: {error}")
        return Accepted()

    def _serve(self, publisher: zenoh.Publisher, appear: Callable[[], None]) -> None:
        """Work until asked to end; managers see the agent from `appear` on."""
        reports = StatusReports(publisher.put, self._clock, self._status())
        is_there = False
        while not self._stopping:
            if not is_there and self._knows_containers():
                is_there = True
                appear()
            self._wait(reports.due if is_there else self._born + ADOPT_LIMIT)
            self._inbox.work()
            self._keep_state()
            self._fence.look()
            self._supervisor.is_cut_off = bool(self._fence.cut_off)
            self._relay.give_up(self._clock.now())
            self._adoption.give_up()
            self._supervisor.reconcile()
            for process in self._supervisor.processes.values():
                process.tell_clocks(self._heartbeats.clocks)
            if is_there:
                reports.note(self._status(), self._fence.arrivals)

    def _knows_containers(self) -> bool:
        """Return whether all that an earlier agent left have said how they are.

        Before, a manager would take what runs for gone. It waits no longer than
        `ADOPT_LIMIT`.
        """
        processes = self._supervisor.processes.values()
        is_known = self._adoption.is_settled() and all(p.status for p in processes)
        return is_known or self._clock.now() >= self._born + ADOPT_LIMIT

    def _wait(self, until: float) -> None:
        """Wait for news until some moment [s], and take them in."""
        supervisor = self._supervisor
        processes = [p for p in supervisor.processes.values() if not p.is_deaf]
        by_fd = {process.connection.fileno(): process for process in processes}
        zygote_fd, lifeline = self._zygote.fileno(), self._setup.lifeline
        of_adoption = self._adoption.files()
        fixed = [self._waker.fileno(), *of_adoption]
        fixed += [] if supervisor.trouble else [zygote_fd]
        fixed += [] if self._stopping or lifeline is None else [lifeline]
        moments = [until, *self._relay.limits(), *supervisor.moments()]
        moments.append(self._adoption.moment())
        limit = max(0.0, min(moments) - self._clock.now())
        ready = wait_readable([*fixed, *by_fd], limit)
        self._adopt(ready)
        for fd in ready.difference(of_adoption):
            if fd in by_fd:
                outcome = supervisor.hear(by_fd[fd])
                if outcome is not None:
                    self._relay.end(outcome)
            elif fd == self._waker.fileno():
                self._waker.clear()
            elif fd == zygote_fd:
                supervisor.hear_zygote()
                self._stopping = self._stopping or bool(supervisor.trouble)
            else:
                self._stopping = True

    def _adopt(self, ready: set[int]) -> None:
        """Take over containers of an earlier agent, and note the ends of such."""
        for pid in self._adoption.ended(ready):
            self._supervisor.note_ended(pid, "ended (an earlier agent had started it)")
        for orphan, connection, stats_page in self._adoption.orphans(ready):
            name, pid = orphan.container, orphan.pid
            if not self._supervisor.adopt(name, pid, connection, stats_page):
                log.warning("container '%s' (process %d) is not adopted", name, pid)
                kill_all({pid})

    def _status(self) -> AgentStatus:
        supervisor = self._supervisor
        statuses = supervisor.statuses()
        used = time.process_time() + supervisor.cpu_of_ended
        usage = self._usage()
        wanted = supervisor.wanted
        return AgentStatus(
            computer=self._setup.computer,
            pid=os.getpid(),
            adopted=self._adoption.num_adopted,
            generation=wanted.generation if wanted else 0,
            token=self._fence.token,
            manager=self._fence.manager,
            uptime=self._clock.now() - self._born,
            cpu=used + sum(status.cpu for status in statuses),
            load=sum(cores for cores, _ in usage.values()),
            memory=sum(size for _, size in usage.values()),
            gateway=self._gateway,
            trouble=self._trouble() or self._folder.trouble,
            cpu_weights=self._supervisor.cpu_weights.means,
            containers=statuses,
            faults=supervisor.health.faults(),
            health=supervisor.records(usage),
            clocks=self._heartbeats.clocks,
            cut_off=self._fence.cut_off,
            links=self._heartbeats.links(),
        )

    def _end_all(self) -> None:
        """End every container in stages; in trouble leave them to the next agent."""
        self._stopping = True
        if self._supervisor.trouble:
            return
        self._adoption.close()
        self._folder.forget()
        forget_output(Path(self._setup.folder))
        self._checkpoints.keep_only(Deployment(generation=0, containers=()))
        self._supervisor.end()
        self._supervisor.reconcile()
        limit = self._clock.now() + STOP_LIMIT + 1
        while self._supervisor.processes and self._clock.now() < limit:
            self._wait(self._clock.now() + 0.1)
            self._supervisor.reconcile()
        for process in self._supervisor.processes.values():
            process.kill()
