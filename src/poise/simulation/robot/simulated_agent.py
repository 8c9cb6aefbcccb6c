"""The agent of a simulated computer: the real core, with modelled surroundings."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import msgspec
import zenoh

from poise.clock import SystemClock, time_asleep
from poise.endpoint import Endpoint
from poise.runtime.agent.core import AgentCore
from poise.runtime.agent.inbox import AgentInbox
from poise.runtime.agent.surroundings import AgentSetup, Reply, Surroundings
from poise.simulation.components.modelled_container import World
from poise.simulation.components.models import drawn
from poise.simulation.robot.container_host import (
    SimulatedAdoption,
    SimulatedHost,
    SimulatedWatchdog,
)
from poise.simulation.robot.simulated_disk import SimulatedDisk
from poise.simulation.robot.simulated_process import Process
from poise.simulation.robot.simulated_sampler import SimulatedSampler
from poise.simulation.schedule.scheduler import SimulatedTask
from poise.wire.control_session import identity_key, locator, open_session
from poise.wire.heartbeats import Hear, Heartbeats, NextBeat
from poise.wire.records.migration_records import StepsDone
from poise.wire.records.request_records import (
    Accepted,
    Answer,
    Claim,
    Claimed,
    ManagerId,
    ManagerRequest,
)
from poise.wire.records.status_records import AgentStatus

PORT = 7447
LEASE = 2.0
_NEWS = "news"


_WAKE = 0.02, 0.15
"""A standby that is woken connects to agents within this time [s]."""


class SimulatedStandby:
    """The `StandbyControl` of a simulated computer."""

    def __init__(self, world: World, process: Process) -> None:
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
        world: World,
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
            lease=LEASE,
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
        with open_session(listen=[where], lease=setup.lease) as session:
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
                setup,
                self._surroundings(adoption, status.put, appear),
                self._disk.left,
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
        clock, process = SystemClock(), self.process

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
            wall=process.computer.wall,
            asleep=time_asleep,
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
            gateway_trouble=str,
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
