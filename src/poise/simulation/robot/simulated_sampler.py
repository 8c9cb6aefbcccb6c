"""Counts what simulated components use, as an agent's sampler does."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from poise.runtime.supervision.health import ContainerUse, Usage
from poise.simulation._engine import Sender
from poise.simulation.components.modelled_container import SimulatedContainer, World
from poise.simulation.robot.simulated_process import Process
from poise.wire.records.status_records import (
    SAMPLE_EVERY,
    AgentSample,
    ComponentSample,
    ConnectorSample,
    ContainerSample,
)


class SimulatedSampler:
    """Samples the containers of an agent's computer for as long as that lives.

    `usage`: what each container uses [cores, bytes].
    `cpu`: what the agent itself has used [core-seconds].
    """

    def __init__(
        self, world: World, process: Process, put: Callable[[bytes], object]
    ) -> None:
        self._world = world
        self._process = process
        self._put = put
        self._group = process.computer.cpu.group()
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
            each.name: ContainerUse(
                (each.cpu - self._before.get(each.pid, each.cpu)) / SAMPLE_EVERY,
                each.memory,
            )
            for each in containers
        }
        self._before = {each.pid: each.cpu for each in containers}
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
            memory=round(sum(each.model.memory for each in components)),
            components=tuple(
                ComponentSample(
                    each.spec.name,
                    each.spec.epoch,
                    each.executor.cpu,
                    0.0,
                    each.executor.asked,
                    each.executor.done,
                )
                for each in components
            ),
            connectors=tuple(map(self._of_sender, container.senders.values())),
        )

    def _of_sender(self, sender: Sender) -> ConnectorSample:
        name, calls, messages = sender.connector.name, sender.calls, sender.messages
        size = round((calls + messages) * self._world.size_of(name))
        return ConnectorSample(name, calls, messages, size, 0, 0, sender.drops)
