"""Starts modelled containers for a real agent core, and hands over earlier ones."""

from __future__ import annotations

from functools import partial
from math import inf
from signal import SIGKILL, Signals
from typing import TYPE_CHECKING

from poise.errors import Unavailable
from poise.runtime.supervision.container_processes import ProcessEnd
from poise.runtime.supervision.health import Silence
from poise.simulation.component_models import drawn
from poise.simulation.robot.modelled_container import SimulatedContainer
from poise.wire.records.deployment_records import ContainerSpec
from poise.wire.records.status_records import FromContainer, ToContainer

if TYPE_CHECKING:
    from poise.simulation.robot.simulated_agent import SimulatedAgent
    from poise.simulation.robot.simulated_robot import SimulatedRobot

_LOCAL = 50e-6
_FORK = 0.005, 0.03
_END = 0.005, 0.05
_ASK_AFTER = 0.05, 0.25
_WATCH_EVERY, _SUSPICIOUS = 0.2, 0.35
ADOPT_LIMIT = 5.0


class SimulatedControl:
    """An agent's end of the connection to a container."""

    def __init__(
        self,
        agent: SimulatedAgent,
        container: SimulatedContainer,
        *,
        born: bool = False,
    ) -> None:
        self._agent = agent
        self._container = container
        self.extend_lease = container.extend_lease  # which has no page
        self._beats = 0
        self._is_born = born
        self._is_closed = False
        self._waiting: list[ToContainer] = []
        agent.process.on_end.append(self._note_agent_gone)
        if born:
            self.join()

    def join(self) -> None:
        """Let the container talk with the agent, from its birth on."""
        container = self._container
        container.tell_agent = self._tell_agent
        for record in self._waiting:
            self._deliver(record)
        self._waiting.clear()

    def note_born(self, pid: int) -> None:
        """Take note of its process."""
        del pid
        self._is_born = True

    def send(self, record: ToContainer) -> None:
        """Tell the container something."""
        if self._container.process.is_dead:
            raise Unavailable(f"container '{self._container.name}' is gone")
        if self._container.tell_agent is None:
            self._waiting.append(record)
        else:
            self._deliver(record)

    def signal(self, number: Signals) -> None:
        """End its process: at once, or when what it does is done."""
        process = self._container.process
        if number == SIGKILL:
            process.kill()
        else:
            choices = self._container.world.choices
            process.after(drawn(choices, _END), process.kill)

    def heartbeat(self) -> int | None:
        """Return a number that stands still while it is paused."""
        if not self._is_born:
            return None
        self._beats += not self._container.process.is_paused
        return self._beats

    def is_lease_past(self) -> bool:
        """Return whether the page says that the lease has ended."""
        process = self._container.process
        return process.computer.boottime() >= self._container.lease_end

    def close(self) -> None:
        """Hear no more of it."""
        self._is_closed = True

    def _deliver(self, record: ToContainer) -> None:
        self._container.process.after(_LOCAL, lambda: self._container.hear(record))

    def _tell_agent(self, record: FromContainer) -> None:
        agent, name = self._agent, self._container.name

        def note() -> None:
            if not self._is_closed:
                agent.core.on_record(name, record)

        agent.process.after(_LOCAL, lambda: agent.post(note))

    def _note_agent_gone(self) -> None:
        if not self._container.process.is_dead:
            self._container.note_agent_gone()


class SimulatedHost:
    """The `ContainerHost` of a simulated computer."""

    cpu_weights = "cgroup v2"

    def __init__(self, world: SimulatedRobot, agent: SimulatedAgent) -> None:
        self._world = world
        self._agent = agent

    def start(self, spec: ContainerSpec) -> SimulatedControl:
        """Begin to start a container."""
        agent, world = self._agent, self._world
        process = agent.process.computer.start(f"container {spec.name}")
        container = SimulatedContainer(world, process, spec.name)
        control = SimulatedControl(agent, container)

        def be_born() -> None:
            if agent.process.is_dead:
                process.kill()  # it never heard what to run
                return
            world.add_container(container)
            control.join()
            agent.post(lambda: agent.core.on_born(spec.name, process.pid))

        def tell_end() -> None:
            agent.core.on_ended(process.pid, ProcessEnd(int(SIGKILL)))

        process.on_end.append(
            lambda: agent.process.after(_LOCAL, lambda: agent.post(tell_end))
        )
        agent.watchdog.watch(container)
        process.after(drawn(world.choices, _FORK), be_born)
        return control

    def settle(self, spec: ContainerSpec, pid: int) -> None:
        """Give a process its weight."""

    def release(self, container: str) -> None:
        """Free nothing: a model has no group."""

    def count_kills(self, now: float) -> None:
        """Count nothing: memory is never short."""

    def explain_kill(self, now: float) -> str:
        """Return nothing: memory is never short."""
        del now
        return ""


class SimulatedAdoption:
    """What an earlier agent left: each container that runs asks to be adopted."""

    def __init__(self, world: SimulatedRobot, agent: SimulatedAgent) -> None:
        self._world = world
        self._agent = agent
        computer = agent.process.computer
        self.adopted: list[str] = []
        self._limit = computer.monotonic() + ADOPT_LIMIT
        self._left = {
            container.process.pid: container
            for container in world.containers_on(computer)
        }

    def begin(self) -> None:
        """Let the containers find the agent."""
        for container in self._left.values():
            self._watch_end(container)
            pause = drawn(self._world.choices, _ASK_AFTER)
            container.process.after(pause, partial(self._ask, container))

    def awaits(self, container: str) -> bool:
        """Return whether a container may run still."""
        return any(left.name == container for left in self._left.values())

    def is_settled(self) -> bool:
        """Return whether all have asked, or have ended."""
        return not self._left

    def watch(self, pid: int) -> bool:
        """Tell of a process's end: its host does that."""
        del pid
        return True

    def moment(self) -> float:
        """Return when `give_up` has something to do [s]."""
        return self._limit if self._left else inf

    def give_up(self) -> None:
        """Kill what did not ask in time."""
        if self._agent.process.computer.monotonic() >= self._limit:
            self._limit = inf
            self.close()

    def close(self) -> None:
        """Kill what was not adopted."""
        for container in list(self._left.values()):
            container.process.kill()

    def _ask(self, container: SimulatedContainer) -> None:
        if self._agent.process.is_dead or container.process.pid not in self._left:
            return
        agent, pid = self._agent, container.process.pid

        def adopt() -> None:
            if self._left.pop(pid, None) is None:
                return
            control = SimulatedControl(agent, container, born=True)
            agent.watchdog.watch(container)
            if agent.core.on_orphan(container.name, pid, control):
                self.adopted.append(container.name)
            else:
                container.process.kill()

        agent.post(adopt)

    def _watch_end(self, container: SimulatedContainer) -> None:
        agent, pid = self._agent, container.process.pid

        def note() -> None:
            self._left.pop(pid, None)
            agent.core.on_ended(pid, "ended (an earlier agent had started it)")

        container.process.on_end.append(
            lambda: agent.process.after(_LOCAL, lambda: agent.post(note))
        )


class SimulatedWatchdog:
    """Tells an agent's core when containers stand still, as the sampler does."""

    def __init__(self, agent: SimulatedAgent) -> None:
        self._agent = agent
        self._since: dict[SimulatedContainer, float] = {}
        self._silent: set[SimulatedContainer] = set()
        self._check()

    def watch(self, container: SimulatedContainer) -> None:
        """Look at a container from now on, until its process ends."""
        self._since[container] = inf
        container.process.on_end.append(lambda: self._forget(container))

    def _forget(self, container: SimulatedContainer) -> None:
        self._since.pop(container, None)
        self._silent.discard(container)

    def _check(self) -> None:
        now = self._agent.process.computer.monotonic()
        for container, since in self._since.items():
            if container.process.is_paused:
                self._since[container] = min(since, now)
                if now - since > _SUSPICIOUS and container not in self._silent:
                    self._silent.add(container)
                    self._tell(container, now - since)
            elif since < inf:
                self._since[container] = inf
                if container in self._silent:
                    self._silent.remove(container)
                    self._tell(container, 0.0)
        self._agent.process.after(_WATCH_EVERY, self._check)

    def _tell(self, container: SimulatedContainer, seconds: float) -> None:
        silence = Silence(
            container=container.name,
            pid=container.process.pid,
            seconds=seconds,
            reason="its process is stopped" if seconds else "",
            remedy="`kill -CONT` lets it go on" if seconds else "",
        )
        agent = self._agent
        agent.post(lambda: agent.core.on_silence(silence))
