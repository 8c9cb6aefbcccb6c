"""A simulated robot: its computers with their agents, its managers, its clients."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

from poise.estimate.demands import kinds_together
from poise.manage.journal import JournalEntry
from poise.runtime.execution.timers import release_offset
from poise.simulation._engine import Connector, Model
from poise.simulation.choices import Choices
from poise.simulation.component_models import ComponentModel
from poise.simulation.network import Addresses, Network, SimulatedDatagrams
from poise.simulation.robot.modelled_component import SimulatedComponent
from poise.simulation.robot.modelled_container import Moment, SimulatedContainer
from poise.simulation.robot.simulated_agent import PORT, SimulatedAgent, SimulatedDisk
from poise.simulation.robot.simulated_manager import ManagedRobot, SimulatedManager
from poise.simulation.robot.simulated_process import Process, SimulatedComputer
from poise.simulation.scheduler import Scheduler
from poise.simulation.simulated_library import SimulatedLibrary
from poise.simulation.workload import SimulatedWork, links_of
from poise.simulation.zenoh_sessions import ZenohNetwork
from poise.wire.records.deployment_records import ConnectorSpec
from poise.wire.records.request_records import Claim, ManagerId

_LONGEST_UPTIME = 1e5
_DRIFT = 25e-6
_CORES = 4.0
_USUAL = ComponentModel()
OUTSIDE = "outside"
"""A computer beside the robot's, on which the manager of emulated computers runs."""


class SimulatedRobot:
    """A robot in virtual time. Use it as a context manager's content: `library()`.

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
        self.network = Network(self.scheduler, choices, links=links_of(robot))
        self.ledger = self.scheduler.engine.ledger
        self.addresses = Addresses()
        self.sessions = ZenohNetwork(self.network, self.addresses)
        self._library = SimulatedLibrary(self.scheduler, self.sessions)
        self.computers: dict[str, SimulatedComputer] = {}
        self.disks: dict[str, SimulatedDisk] = {}
        self.agents: dict[str, SimulatedAgent] = {}
        self.managers: list[SimulatedManager] = []
        self.endpoints: dict[str, str] = {}
        self.is_stopped = False
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
                self.scheduler, known.name, boot, drift, cores, known.speed
            )
            self.computers[known.name] = computer
            self.disks[known.name] = SimulatedDisk(computer)
            host = self.addresses.add(known.name)
            self.endpoints[known.name] = f"tcp/{host}:{PORT}"
        self._outside = SimulatedComputer(self.scheduler, OUTSIDE)
        self.addresses.add(OUTSIDE)

    def library(self) -> AbstractContextManager[None]:
        """Return what gives the code under test virtual time, while it is entered."""
        return self._library

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

    def start_standby(self, computer: str) -> Callable[[], bool]:
        """Let a standby try to lead; return what says whether it still runs."""
        manager = self.start_manager(computer, is_standby=True)
        return lambda: not manager.process.is_dead

    def start_manager(
        self, computer: str, *, take_over: bool = False, is_standby: bool = False
    ) -> SimulatedManager:
        """Start a manager on a computer, or outside of all."""
        number = len(self.managers)
        where = self.computers.get(computer, self._outside)
        process = where.start(f"manager {number}")

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
        """Start a manager on a computer, unless one runs: somebody asks for it."""
        if self.manager is None and not self.is_stopped:
            self.start_manager(computer)

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
            self._models[component] = model.made_in(engine, release_offset(component))
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
        found = map(self._containers.get, computer.processes)
        return [container for container in found if container is not None]

    def working(self) -> dict[str, list[str]]:
        """Return component -> the computers where it works."""
        found: dict[str, list[str]] = {}
        for container in self.containers():
            if not container.process.is_paused:
                at = container.process.computer.name
                for component in container.components.values():
                    if component.executor.is_working:
                        found.setdefault(component.spec.name, []).append(at)
        return found

    def names_at_work(self) -> set[str]:
        """Return the components that work somewhere."""
        return {
            component.spec.name
            for container in self.containers()
            if not container.process.is_paused
            for component in container.components.values()
            if component.executor.is_working
        }

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

    def size_of(self, connector: str) -> float:
        """Return the size of a message, or of a call both ways [bytes]."""
        return self.workload.traffic.size_of(connector)

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
