"""A manager in a simulated process: the real one, wired as `poise up` wires it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct

from poise.clock import SystemClock
from poise.errors import PoiseError, TakenOver
from poise.estimate.profiles import Profile
from poise.manage.agent_connections.agents import Agents
from poise.manage.control_socket.commands import Command, Refusal, Result, RobotStatus
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.deploy.takeover import start_or_take_over
from poise.manage.journal import Journal, JournalEntry
from poise.manage.manager import TICK, Manager
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.sample_recording import Recording
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.saved_tasks import goes_on_with
from poise.model.robot import Robot
from poise.simulation.robot.simulated_process import Process
from poise.wire.heartbeats import Datagrams
from poise.wire.records.request_records import Election

SOLVE_STEPS = 20_000
"""The planner searches so much, whatever the machine: a seed gives one run."""
_MISSING_LIMIT = 2.0
_AGENT_LIMIT = 20.0
_LEASE = 2.0


class ManagedRobot(Struct, frozen=True, kw_only=True):
    """What all managers of a simulated robot are told.

    `placement`: component -> computer, of what they start if nothing runs.
    `tasks`: names of tasks.
    `adapts`: whether they change the placement by themselves.
    `profile`: what demands are compared with; None: with what was needed at first.
    `election`: how they follow each other; None: they do not by themselves.
    """

    robot: Robot
    placement: Mapping[str, str]
    tasks: Sequence[str]
    adapts: bool = True
    profile: Profile | None = None
    election: Election | None = None


class SimulatedManager:
    """One start of a manager.

    `endpoints`: computer -> zenoh endpoint of its agent.
    `datagrams`: carries its heartbeats.
    `note`: takes each entry of its journal.
    `manager`: None until the robot is up.
    `up_since`: since when it is [s of the simulation].
    `error`: why it could not come up, or ended; None: it has not.
    """

    def __init__(
        self,
        setup: ManagedRobot,
        endpoints: Mapping[str, str],
        process: Process,
        datagrams: Datagrams,
        note: Callable[[JournalEntry], object],
        *,
        take_over: bool = False,
        is_standby: bool = False,
    ) -> None:
        self._setup = setup
        self._endpoints = endpoints
        self.process = process
        self.manager: Manager | None = None
        self.up_since = math.inf
        self.on_up: Callable[[], object] = lambda: None
        self.run: RunningComponents | None = None
        self.error: PoiseError | None = None
        self._datagrams = datagrams
        self._note = note
        self._takes_over = take_over
        self._is_standby = is_standby
        process.spawn("manager", self._main)

    def ask_status(self, take: Callable[[RobotStatus], object]) -> None:
        """Let a client ask for the status; nobody answers while it is not up."""

        def answer() -> None:
            if self.manager is not None:
                take(self.manager.status())

        self.process.spawn("client status", answer)

    def ask(self, command: Command, take: Callable[[Result | Refusal], object]) -> None:
        """Submit a command from a client; `take` gets its result."""

        def submit() -> None:
            assert self.manager is not None  # noqa: S101, clients ask what is up
            future = self.manager.submit(command)
            take(future.result())

        self.process.spawn(f"client {type(command).__name__}", submit)

    def _main(self) -> None:
        try:
            self._come_up()
        except PoiseError as error:
            self.error = error
        self.process.exit()

    def _come_up(self) -> None:
        setup, robot = self._setup, self._setup.robot
        journal, samples = Journal(":memory:", self._note), Recording()
        with Agents(
            robot.name,
            self._endpoints,
            SystemClock(),
            samples.add,
            lease=_LEASE,
            datagrams=self._datagrams,
            election=setup.election,
        ) as agents:
            if not agents.wait_at_work(_MISSING_LIMIT):
                agents.wait_alive(self._endpoints, _AGENT_LIMIT)
            placement = {} if self._is_standby else setup.placement
            run = self.run = RunningComponents(
                robot, placement, agents, journal, "/robot"
            )
            run.solve_steps = SOLVE_STEPS
            start_or_take_over(run, by_force=self._takes_over)
            asked = Tasks(robot, lambda text: journal.note("decided", text))
            for name in () if self._is_standby else setup.tasks:
                asked.start(name, self.process.computer.wall())
            asked.arbitrate(self.process.computer.wall())
            self.manager = Manager(
                run,
                goes_on_with(run, asked, journal),
                Estimates(robot, setup.profile, emulated=True),
                samples,
                adapts=setup.adapts,
            )
            self.up_since = self.process.scheduler.now
            self.on_up()
            try:
                while not self.manager.is_stopping:
                    self.manager.work(TICK)
            except TakenOver as error:
                self.error = error
                self.manager.end()
            else:
                self.manager.stop()
