"""The agent of a simulated computer: the real core; sampler and disk are models."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from functools import partial
from typing import TYPE_CHECKING

import msgspec
import zenoh

from poise.endpoint import Endpoint
from poise.runtime.agent.core import AgentCore
from poise.runtime.agent.inbox import AgentInbox
from poise.runtime.agent.surroundings import AgentSetup, AgentState, Reply, Surroundings
from poise.runtime.supervision.health import ContainerUse, Usage
from poise.simulation._engine import Sender
from poise.simulation.component_models import SIZE, drawn
from poise.simulation.robot.container_host import (
    SimulatedAdoption,
    SimulatedHost,
    SimulatedWatchdog,
)
from poise.simulation.robot.modelled_component import SimulatedComponent
from poise.simulation.robot.modelled_container import SimulatedContainer
from poise.simulation.robot.simulated_process import (
    Process,
    ProcessClock,
    SimulatedComputer,
)
from poise.simulation.scheduler import SimulatedTask
from poise.wire.control_session import identity_key, locator, open_session
from poise.wire.heartbeats import Hear, Heartbeats, NextBeat
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import StepsDone
from poise.wire.records.request_records import (
    Accepted,
    Answer,
    CheckpointCopy,
    Claim,
    Claimed,
    ManagerId,
    ManagerRequest,
    OutputLines,
    ReadOutput,
    Refused,
)
from poise.wire.records.status_records import (
    SAMPLE_EVERY,
    AgentSample,
    AgentStatus,
    ComponentSample,
    ConnectorSample,
    ContainerSample,
)

if TYPE_CHECKING:
    from poise.simulation.robot.simulated_robot import SimulatedRobot

PORT = 7447
_NEWS = "news"


_WAKE = 0.02, 0.15
"""A standby that is woken connects to agents within this time [s]."""


class SimulatedStandby:
    """The `StandbyControl` of a simulated computer."""

    def __init__(self, world: SimulatedRobot, process: Process) -> None:
        self._world = world
        self._process = process
        self._claim: Claim | None = None
        self._is_leading: Callable[[], bool] = lambda: False

    def keep(self, claim: Claim | None) -> None:
        """Let one wait, which needs no process before it leads."""
        self._claim = claim

    def lead(self) -> None:
        """Start a manager, unless it runs."""
        if self._claim is not None and not self._is_leading():
            self._is_leading = lambda: True
            pause = drawn(self._world.choices, _WAKE)
            self._process.after(pause, self._start)

    def _start(self) -> None:
        self._is_leading = self._world.start_standby(self._process.computer.name)


class SimulatedAgent:
    """One start of an agent.

    `process`: its process.
    `address`: the IP address of its computer.
    `say`: takes what it says, for the trace.
    """

    def __init__(
        self,
        world: SimulatedRobot,
        robot: str,
        process: Process,
        address: str,
        disk: SimulatedDisk,
        say: Callable[[str], object],
    ) -> None:
        self._world = world
        self.process = process
        self._setup = AgentSetup(
            robot=robot,
            computer=process.computer.name,
            address=address,
            port=PORT,
            folder="",
        )
        self._disk = disk
        self._say = say
        self._events: deque[Callable[[], object]] = deque()
        self._task: SimulatedTask | None = None
        self._is_woken = False
        self._claimed = 0
        self._obeyed: ManagerId | None = None
        self._sampler: SimulatedSampler
        self.core: AgentCore
        self.watchdog: SimulatedWatchdog
        self._task = process.spawn("agent", self._main)

    def post(self, event: Callable[[], object]) -> None:
        """Let the agent's own task take note of something."""
        self._events.append(event)
        self.wake()

    def wake(self) -> None:
        """Let it tick soon; from any task."""
        self._is_woken = True
        if self._task is not None and self._task.waits_for == _NEWS:
            self._world.scheduler.wake(self._task)

    def _main(self) -> None:
        setup = self._setup
        prefix, name = f"poise/{setup.robot}", setup.computer
        where = locator(Endpoint(setup.address, setup.port))
        with open_session(listen=[where]) as session:
            status = session.declare_publisher(f"{prefix}/status/{name}")
            copies = session.declare_publisher(f"{prefix}/checkpoint/{name}")
            self._disk.begin(
                self.process, lambda copy: copies.put(msgspec.msgpack.encode(copy))
            )

            samples = session.declare_publisher(f"{prefix}/samples/{name}")
            self._sampler = SimulatedSampler(self._world, self.process, samples.put)

            def appear() -> None:
                for key in (
                    f"{prefix}/alive/{name}",
                    identity_key(where, setup.robot, name),
                ):
                    session.liveliness().declare_token(key)

            self.watchdog = SimulatedWatchdog(self)
            adoption = SimulatedAdoption(self._world, self)
            self.core = AgentCore(
                setup, self._surroundings(adoption, status.put, appear), self._disk.left
            )
            inbox = AgentInbox(name, self._on_request, self.wake, self.core.supervised)
            session.declare_queryable(f"{prefix}/agent/{name}", inbox.hear)
            session.liveliness().declare_subscriber(
                f"{prefix}/manager/*", self._note_manager, history=True
            )
            adoption.begin()
            while True:
                self._wait(self.core.moment())
                while self._events:
                    self._events.popleft()()
                inbox.work()
                self.core.tick()

    def _surroundings(
        self,
        adoption: SimulatedAdoption,
        put: Callable[[bytes], object],
        appear: Callable[[], None],
    ) -> Surroundings:
        process, computer = self.process, self.process.computer
        clock = ProcessClock(computer)

        def publish(status: AgentStatus) -> None:
            for error in status.errors:
                what = f"{process.name}: {error.where}: {error.text}"
                self._world.ledger.violate("no-bug-stops-the-robot", what)
            put(msgspec.msgpack.encode(status))

        def heartbeats(hear: Hear, next_beat: NextBeat) -> Heartbeats:
            datagrams = self._world.datagrams_of(process, self._setup.port)
            return Heartbeats(clock, hear, next_beat, datagrams)

        return Surroundings(
            clock=clock,
            wall=computer.wall,
            asleep=computer.asleep,
            random=process.random,
            say=self._say,
            publish=publish,
            appear=appear,
            wake=self.wake,
            host=SimulatedHost(self._world, self),
            adoption=adoption,
            disk=self._disk,
            standby=SimulatedStandby(self._world, process),
            heartbeats=heartbeats,
            usage=lambda: self._sampler.usage,
            cpu=lambda: self._sampler.cpu,
            gateway=f"{self._setup.address}:7448",
            trouble=str,
            pid=process.pid,
            key=f"{process.random.getrandbits(128):032x}",
        )

    def _on_request(self, asked: ManagerRequest, reply: Reply) -> None:
        """Let the core answer, and see that it does nothing for an earlier manager."""
        claimed = self._claimed

        def check(answer: Answer) -> None:
            is_done = isinstance(answer, Accepted | StepsDone)
            if is_done and asked.token < claimed:
                self._world.ledger.violate(
                    "one-manager-is-obeyed",
                    f"{self.process.name}, claimed with token {claimed}, did "
                    f"{type(asked.request).__name__} for token {asked.token}",
                )
            request = asked.request
            is_claimed = isinstance(answer, Claimed)
            if is_claimed and isinstance(request, Claim) and not request.is_poll:
                self._claimed, before = asked.token, self._obeyed
                self._obeyed = request.manager
                if before is not None:
                    computer = self.process.computer.name
                    self._world.on_claim(computer, request, before)
            reply(answer)

        self.core.on_request(asked, check)

    def _note_manager(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).rpartition("/")[2]
        is_there = sample.kind == zenoh.SampleKind.PUT
        self.core.heartbeats.note_liveliness(key, is_there=is_there)
        self.wake()

    def _wait(self, moment: float) -> None:
        if not self._is_woken:
            left = moment - self.process.computer.monotonic()
            if left > 0:
                self._world.scheduler.wait(left, _NEWS)
        self._is_woken = False


class SimulatedSampler:
    """Samples the containers of an agent's computer for as long as that lives.

    `usage`: what each container uses [cores, bytes].
    `cpu`: what the agent itself has used [core-seconds].
    """

    def __init__(
        self, world: SimulatedRobot, process: Process, put: Callable[[bytes], object]
    ) -> None:
        self._world = world
        self._process = process
        self._put = put
        self._group = process.computer.cpu.group()
        self._sizes = world.workload.traffic.sizes
        self._encode = msgspec.msgpack.Encoder().encode
        self._before: dict[int, float] = {}
        self.usage: Usage = {}
        process.on_end.append(self._group.end)
        process.on_pause = lambda is_paused: self._group.pause(is_paused=is_paused)
        self._again()

    @property
    def cpu(self) -> float:
        """What the agent itself has used [core-seconds]."""
        return self._group.used

    def _again(self) -> None:
        self._process.after(SAMPLE_EVERY, self._sample)

    def _sample(self) -> None:
        if work := self._world.agent_cpu * SAMPLE_EVERY:
            self._group.run(work)
        computer = self._process.computer
        busy = computer.cpu.used()
        here = self._world.containers_on(computer)
        containers = tuple(map(self._of_container, here))
        self.usage = {
            container.name: ContainerUse(
                (container.cpu - self._before.get(container.pid, container.cpu))
                / SAMPLE_EVERY,
                container.memory,
            )
            for container in containers
        }
        self._before = {container.pid: container.cpu for container in containers}
        at = computer.monotonic()
        sample = AgentSample(computer.name, at, self._group.used, containers, busy)
        self._put(self._encode(sample))
        self._again()

    def _of_container(self, container: SimulatedContainer) -> ContainerSample:
        components = container.components.values()
        return ContainerSample(
            name=container.name,
            pid=container.process.pid,
            at=container.process.computer.monotonic(),
            cpu=container.execution.cpu.used,
            memory=round(sum([component.model.memory for component in components])),
            components=tuple(map(_of_component, components)),
            connectors=tuple(map(self._of_sender, container.senders.values())),
        )

    def _of_sender(self, sender: Sender) -> ConnectorSample:
        name, calls, messages = sender.connector.name, sender.calls, sender.messages
        size = round((calls + messages) * self._sizes.get(name, SIZE))
        return ConnectorSample(name, calls, messages, size, 0, 0, sender.drops)


def _of_component(component: SimulatedComponent) -> ComponentSample:
    spec, executor = component.spec, component.executor
    return ComponentSample(
        spec.name, spec.epoch, executor.cpu, 0.0, executor.asked, executor.done
    )


_SEND_WITHIN = 0.1
Key = tuple[str, int]


class SimulatedDisk:
    """The `AgentDisk` of a simulated computer; it outlives its agents.

    `left`: what an agent has kept, as far as it was written before it was killed.
    `num_full`: how many faults let nothing be written.
    `delay`: how long each write takes [s]: a fault makes it long.
    """

    def __init__(self, computer: SimulatedComputer) -> None:
        self.left = AgentState()
        self.num_full = 0
        self.delay = 0.001
        self._computer = computer
        self._kept = self.left
        self._wanted: tuple[Key, ...] = ()
        self._checkpoints: dict[Key, tuple[float, bytes]] = {}
        self._sent: dict[Key, float] = {}
        self._send: Callable[[CheckpointCopy], object] = lambda _: None
        self._is_sending = False

    def begin(self, process: Process, send: Callable[[CheckpointCopy], object]) -> None:
        """Serve another agent."""
        self._process, self._send, self._sent = process, send, {}
        self._kept = self.left
        self._is_sending = False
        self._send_soon()

    def restart(self) -> None:
        """Lose what counts only until the next boot: all."""
        self.left, self._checkpoints = AgentState(), {}

    def keep(self, state: AgentState) -> None:
        """Keep what the next agent must know, if it changed."""
        if state != self._kept:
            self._kept = state
            self._process.after(self.delay, lambda: self._keep(state))

    def forget(self) -> None:
        """Leave nothing to the next agent."""
        self.keep(AgentState())

    def serve(self, request: ReadOutput | CheckpointCopy, reply: Reply) -> None:
        """Write a checkpoint, or read output, of which there is none."""
        if isinstance(request, ReadOutput):
            reply(OutputLines())
        elif self.num_full:
            reply(Refused("it cannot use its folder: no space left on device"))
        else:
            self._process.after(self.delay, lambda: self._store(request))
            self._process.after(self.delay, lambda: reply(Accepted()))

    def keep_only(self, wanted: Deployment) -> None:
        """Remove the checkpoints of all that is not wanted, and send the others."""
        kept = {c.key for c in wanted.components}
        self._checkpoints = {k: v for k, v in self._checkpoints.items() if k in kept}
        self._wanted = tuple(c.key for c in wanted.components if c.checkpoint)
        self._send_soon()

    def remove_checkpoints(self, of: Collection[tuple[str, int]]) -> None:
        """Remove the checkpoints of these names and epochs."""
        for key in of:
            self._checkpoints.pop(key, None)

    def resend(self) -> None:
        """Send all checkpoints again."""
        self._sent = {}
        self._send_soon()

    def checkpoint_age(self, component: str, epoch: int) -> float | None:
        """Return how old the last checkpoint is [s]; None: there is none."""
        at, _ = self._checkpoints.get((component, epoch), (None, b""))
        return None if at is None else self._computer.boottime() - at

    def trouble(self) -> str:
        """Return what is wrong with it."""
        return "no space left on device" if self.num_full else ""

    def _keep(self, state: AgentState) -> None:
        if self.num_full:  # better nothing than what holds no more; it is tried again
            state = self._kept = AgentState()
        self.left = state

    def _store(self, copy: CheckpointCopy) -> None:
        at = self._computer.boottime() - copy.age
        self._checkpoints[copy.component, copy.epoch] = at, copy.data or b""
        self._send_soon()

    def _send_soon(self) -> None:
        """Send copies of new checkpoints within a moment; of several one."""
        if not self._is_sending:
            self._is_sending = True
            self._process.after(_SEND_WITHIN, self._send_new)

    def _send_new(self) -> None:
        self._is_sending = False
        for key in self._wanted:
            at, data = self._checkpoints.get(key, (0.0, b""))
            if data and self._sent.get(key) != at:
                self._sent[key] = at
                age = self._computer.boottime() - at
                copy = CheckpointCopy(
                    component=key[0], epoch=key[1], data=data, age=age
                )
                self._process.spawn("checkpoint", partial(self._send, copy))
