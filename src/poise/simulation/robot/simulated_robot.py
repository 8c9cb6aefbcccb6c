"""A simulated robot: its computers with their agents, its managers, its clients."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct
from msgspec.msgpack import encode

from poise.clock import boot_time
from poise.errors import PoiseError, TakenOver
from poise.estimate.demands import kinds_together
from poise.estimate.outcomes import WELL
from poise.estimate.profiles import Profile
from poise.manage.agent_connections.agents import Agents
from poise.manage.control_socket.commands import Command, Refusal, Result
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.takeover import start_or_take_over
from poise.manage.journal import Journal, JournalEntry
from poise.manage.manager import TICK, Manager
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.sample_recording import Recording
from poise.manage.tasks.component_reports import choose
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.saved_tasks import goes_on_with
from poise.model.robot import Robot
from poise.simulation._engine import Connector, Model
from poise.simulation.choices import Choices
from poise.simulation.component_models import ComponentModel
from poise.simulation.link_models import links_of
from poise.simulation.network import Addresses, Network, SimulatedDatagrams
from poise.simulation.robot.modelled_component import SimulatedComponent
from poise.simulation.robot.modelled_container import Moment, SimulatedContainer
from poise.simulation.robot.simulated_agent import PORT, SimulatedAgent, SimulatedDisk
from poise.simulation.robot.simulated_process import (
    Process,
    ProcessClock,
    SimulatedComputer,
)
from poise.simulation.scheduler import Scheduler
from poise.simulation.simulated_library import SimulatedLibrary
from poise.simulation.workload import SimulatedWork
from poise.simulation.zenoh_sessions import ZenohNetwork
from poise.wire.heartbeats import Datagrams
from poise.wire.records.deployment_records import ConnectorSpec
from poise.wire.records.request_records import Claim, Election, ManagerId

SOLVE_STEPS = 20_000
"""The planner searches so much, whatever the machine: a seed gives one run."""
_MISSING_LIMIT = 2.0
_AGENT_LIMIT = 20.0


class ManagedRobot(Struct, frozen=True, kw_only=True):
    """What all managers of a simulated robot are told.

    `placement`: component -> computer, of what they start if nothing runs.
    `tasks`: names of tasks.
    `suspended`: why not all that the tasks need starts then; empty: it does.
    `adapts`: whether they change the placement by themselves.
    `profile`: what demands are compared with; None: with what was needed at first.
    `election`: how they follow each other; None: they do not by themselves.
    """

    robot: Robot
    placement: Mapping[str, str]
    tasks: Sequence[str]
    suspended: str = ""
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
        self.live: LiveRobot | None = None
        self.error: PoiseError | None = None
        self._datagrams = datagrams
        self._note = note
        self._takes_over = take_over
        self._is_standby = is_standby
        process.spawn("manager", self._main)

    def ask(
        self, command: Command, on_result: Callable[[Result | Refusal], object]
    ) -> None:
        """Submit a command from a client; `on_result` gets its result."""

        def submit() -> None:
            assert self.manager is not None  # noqa: S101, clients ask what is up
            future = self.manager.submit(command)
            on_result(future.result())

        self.process.spawn(f"client {type(command).__name__}", submit)

    def _main(self) -> None:
        try:
            self._come_up()
        except PoiseError as error:
            self.error = error
        self.process.kill()

    def _come_up(self) -> None:
        setup, robot = self._setup, self._setup.robot
        journal, samples = Journal(":memory:", self._note), Recording()
        clock = ProcessClock(self.process.computer)
        with Agents(
            robot.name,
            self._endpoints,
            clock,
            samples.add,
            datagrams=self._datagrams,
            election=setup.election,
        ) as agents:
            if not agents.wait_at_work(_MISSING_LIMIT):
                agents.wait_alive(self._endpoints, _AGENT_LIMIT)
            placement = {} if self._is_standby else setup.placement

            def say(text: str) -> None:
                journal.note("decided", text)

            asked = Tasks(robot, say, lambda c, _: choose(robot, c, WELL, say))
            for name in () if self._is_standby else setup.tasks:
                asked.start(name, boot_time())
            asked.arbitrate(boot_time())
            live = self.live = LiveRobot(
                robot, placement, agents, journal, "/robot", clock=clock
            )
            live.begin_with(encode(asked.saved))
            live.solve_steps = SOLVE_STEPS
            live.learns = False
            start_or_take_over(
                live, by_force=self._takes_over, follows=self._is_standby
            )
            self.manager = Manager(
                live,
                goes_on_with(live, asked, journal),
                Estimates(robot, setup.profile, emulated=True),
                samples,
                adapts=setup.adapts,
                suspended="" if self._is_standby else setup.suspended,
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


_LONGEST_UPTIME = 1e5
_DRIFT = 25e-6
_CORES = 4.0
_USUAL = ComponentModel()
OUTSIDE = "outside"
"""A computer beside the robot's, on which the manager of emulated computers runs."""


class SimulatedRobot:
    """A robot in virtual time.

    `managed`: the robot, and what its managers are told.
    `workload`: what its components do.
    `note`: called with each line of the trace: the moment [s], who, and what.
    `agents`, `managers`: those that run, by computer; and all managers so far, the last
    one last.
    `components`: all incarnations of components so far.
    `on_moment`: called with ``steps`` and a computer when a container gets steps of a
    migration, with ``up`` when a manager is up there, and with ``paused`` when the one
    there hangs.
    `on_claim`: called with a computer, a claim that its agent accepted, and the manager
    that it obeyed before.
    `on_entry`: called with each entry of a manager's journal.
    """

    def __init__(
        self,
        managed: ManagedRobot,
        choices: Choices,
        workload: SimulatedWork,
        note: Callable[[float, str, str], object] = lambda *_: None,
    ) -> None:
        self._managed = managed
        robot = self.robot = managed.robot
        self.choices = choices
        self.scheduler = Scheduler(choices)
        self.network = Network(self.scheduler, links_of(robot))
        self.ledger = self.scheduler.engine.ledger
        self.addresses = Addresses()
        self.sessions = ZenohNetwork(self.network, self.addresses)
        self.library = SimulatedLibrary(self.scheduler, self.sessions)
        self.computers: dict[str, SimulatedComputer] = {}
        self.disks: dict[str, SimulatedDisk] = {}
        self.agents: dict[str, SimulatedAgent] = {}
        self.managers: list[SimulatedManager] = []
        self.endpoints: dict[str, str] = {}
        self.is_stopped = False
        self._num_holds = Counter[str]()
        self.on_moment: Callable[[Moment, str], object] = lambda *_: None
        self.on_claim: Callable[[str, Claim, ManagerId], object] = lambda *_: None
        self.on_entry: Callable[[JournalEntry], object] = lambda _: None
        self.components: list[SimulatedComponent] = []
        self.workload = workload
        self.agent_cpu = workload.agent
        self._kinds = kinds_together(robot)
        self._where: dict[tuple[str, str, int], SimulatedContainer] = {}
        self._models: dict[str, Model] = {}
        self._connectors: dict[ConnectorSpec, Connector] = {}
        self._note = note
        self._containers: dict[int, SimulatedContainer] = {}
        random = choices.random("clocks")
        for known in robot.computers:
            boot, drift = random.uniform(1, _LONGEST_UPTIME), random.uniform(-1, 1)
            cores = known.capacity.get("cpu", _CORES)
            drift *= _DRIFT
            computer = SimulatedComputer(
                self.scheduler,
                known.name,
                boot,
                drift,
                cores,
                known.speed,
                is_emulated=known.address is None,
            )
            self.computers[known.name] = computer
            self.disks[known.name] = SimulatedDisk(computer)
            host = self.addresses.add(known.name)
            self.endpoints[known.name] = f"tcp/{host}:{PORT}"
        self._outside = SimulatedComputer(self.scheduler, OUTSIDE)
        self.addresses.add(OUTSIDE)

    def others_than(self, computer: str) -> list[str]:
        """Return the other computers, and where a manager beside them runs."""
        return [name for name in (*self.computers, OUTSIDE) if name != computer]

    def start_agent(self, computer: str) -> None:
        """Start an agent where none runs."""
        if computer in self.agents:
            return
        process = self.computers[computer].start("agent")
        self.agents[computer] = SimulatedAgent(
            self,
            self.robot.name,
            process,
            self.addresses.host_of(computer),
            self.disks[computer],
            lambda text: self.note(f"agent {computer}", text),
        )
        process.on_end.append(lambda: self.agents.pop(computer, None))

    def hold_agent(self, computer: str) -> Callable[[], None]:
        """Let no fault start an agent again; return what is called when that is over.

        Then it starts, unless another fault holds it.
        """
        self._num_holds[computer] += 1

        def start() -> None:
            self._num_holds[computer] -= 1
            if not self._num_holds[computer]:
                self.start_agent(computer)

        return start

    def start_standby(self, computer: str) -> Callable[[], bool]:
        """Let a standby try to lead; return what says whether it still runs."""
        manager = self.start_manager(computer, is_standby=True)
        return lambda: not manager.process.is_dead

    def start_manager(
        self, computer: str, *, take_over: bool = False, is_standby: bool = False
    ) -> SimulatedManager:
        """Start a manager on a computer, or outside of all."""
        number = len(self.managers)
        process = self._computer(computer).start(f"manager {number}")

        def note(entry: JournalEntry) -> None:
            if process.is_dead:
                return
            self.note(f"manager {number}", f"{entry.kind}: {entry.what}")
            self.on_entry(entry)
            if "traceback" in entry.facts:
                what = f"{process.name}: {entry.facts['traceback']}"
                self.ledger.violate("no-bug-stops-the-robot", what)

        manager = SimulatedManager(
            self._managed,
            self.endpoints,
            process,
            self.datagrams_of(process, None),
            note,
            take_over=take_over,
            is_standby=is_standby,
        )
        manager.on_up = lambda: self.on_moment("up", computer)
        self.managers.append(manager)
        return manager

    def keep_managed(self, computer: str) -> None:
        """Start a manager on a computer, unless one runs: somebody asks for it.

        Where there is no power, that waits for it.
        """

        def start() -> None:
            if self.manager is None and not self.is_stopped:
                self.start_manager(computer)

        self._computer(computer).when_on(start)

    def _computer(self, name: str) -> SimulatedComputer:
        return self.computers.get(name, self._outside)

    def is_reached(self) -> bool:
        """Return whether each agent runs, and each computer reaches each other one."""
        running = [a for a in self.agents.values() if not a.process.is_paused]
        return len(running) == len(self.computers) and not any(
            self.network.is_cut(here, there)
            for here in (*self.computers, OUTSIDE)
            for there in self.others_than(here)
        )

    @property
    def manager(self) -> SimulatedManager | None:
        """The last manager that is up, or starts; None: none runs."""
        running = [manager for manager in self.managers if not manager.process.is_dead]
        up = [manager for manager in running if manager.manager is not None]
        return next(reversed(up or running), None)

    def note(self, who: str, what: str) -> None:
        """Add a line to the trace."""
        self._note(self.scheduler.now, who, what)

    def model_of(self, component: str) -> ComponentModel:
        """Return the model of a component."""
        return self.workload.models.get(component, _USUAL)

    def engine_model_of(self, component: str) -> Model:
        """Return the model of a component as the engine has it."""
        if component not in self._models:
            model, engine = self.model_of(component), self.scheduler.engine
            random = self.choices.random("devices")
            self._models[component] = model.made_in(engine, component, random)
        return self._models[component]

    def connector_of(self, spec: ConnectorSpec) -> Connector:
        """Return a connector as the engine has it."""
        known = self._connectors.get(spec)
        if known is None:
            together = self._kinds.get(spec.name, "local")
            known = self.workload.traffic.connector_in(
                self.scheduler.engine, spec, together
            )
            self._connectors[spec] = known
        return known

    def add_container(self, container: SimulatedContainer) -> None:
        """Let a container be found until its process ends."""
        pid = container.process.pid
        self._containers[pid] = container
        container.process.on_end.append(lambda: self._containers.pop(pid, None))

    def containers(self) -> list[SimulatedContainer]:
        """Return all containers that run."""
        return [c for c in self._containers.values() if not c.process.is_dead]

    def containers_on(self, computer: SimulatedComputer) -> list[SimulatedContainer]:
        """Return the containers that run on a computer."""
        containers = map(self._containers.get, computer.processes)
        return [container for container in containers if container is not None]

    def working(self) -> list[tuple[str, str]]:
        """Return which components work, and on which computers."""
        return [
            (component.spec.name, container.process.computer.name)
            for container in self.containers()
            if not container.process.is_paused
            for component in container.components.values()
            if component.executor.is_working
        ]

    def container_of(
        self, computer: str, component: str, epoch: int
    ) -> SimulatedContainer | None:
        """Return the container of an incarnation on a computer."""
        key = computer, component, epoch
        known = self._where.get(key)
        if (
            known is not None
            and not known.process.is_dead
            and key[1:] in known.components
        ):
            return known
        for container in self.containers_on(self.computers[computer]):
            if (component, epoch) in container.components:
                self._where[key] = container
                return container
        return None

    def datagrams_of(self, process: Process, port: int | None) -> SimulatedDatagrams:
        """Return what carries heartbeats to and from a port; None: a free one."""
        return SimulatedDatagrams(self.addresses, self.network, process, port)

    def run(self, until: float) -> None:
        """Let virtual time pass until a moment [s]."""
        self.scheduler.run(until)

    def end(self) -> None:
        """End all processes, so that nothing of the run is left."""
        for computer in (*self.computers.values(), self._outside):
            for process in list(computer.processes.values()):
                process.kill()
        self.scheduler.run(self.scheduler.now)
        self.scheduler.engine.end()
