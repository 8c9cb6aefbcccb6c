"""The components of a placement alone, in virtual time: how old data gets.

No manager and no agent runs, and nothing moves or breaks: what is left takes a few
microseconds for each run of a handler, so that a placement can be looked at before
anything runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from random import Random

from poise.estimate.overhead import kinds_together
from poise.manage.deploy.deployment_plan import DeploymentPlan
from poise.manage.deploy.incarnation import Incarnation
from poise.model.robot import Robot
from poise.runtime.component.ports import Timer
from poise.runtime.execution.timers import release_offset
from poise.simulation._engine import Engine, Executor
from poise.simulation.components.models import ComponentModel, HandlerModel, TimerModel
from poise.simulation.network.links import links_of, set_links
from poise.simulation.schedule.choices import Choices
from poise.simulation.workload import SimulatedWork
from poise.wire.records.status import ChainStatus, TimerStatus

_CORES = 4.0
_USUAL = ComponentModel()
_WEIGHT = 100.0
_SAMPLES_EVERY = 0.1
_REFILLED_EVERY = 0.01
"""An emulated computer gets its share of CPU this often [s], from any moment on."""


class PlacedComponents:
    """The components of a placement, at work.

    Parameters
    ----------
    placement
        Component -> computer; of all that runs.
    work
        What the components do.
    seed
        How long handlers take is drawn, and when emulated computers get their shares.
    """

    def __init__(
        self,
        robot: Robot,
        placement: Mapping[str, str],
        work: SimulatedWork,
        seed: int = 0,
    ) -> None:
        self._engine = Engine(seed)
        self._executors: dict[str, Executor] = {}
        set_links(self._engine, links_of(robot))
        self._add_components(robot, placement, work, Choices(seed).random("refills"))
        for executor in self._executors.values():
            executor.activate()

    @property
    def now(self) -> float:
        """Virtual time that has passed [s]."""
        return self._engine.now

    def run(self, until: float) -> None:
        """Let virtual time pass until a moment [s]."""
        while self._engine.run(until) < until or self._engine.notify():
            self._engine.notify()

    def chains(self, component: str) -> tuple[ChainStatus, ...]:
        """Return how old the data was that a component used."""
        return self._executors[component].chains()

    def timers(self, component: str) -> tuple[TimerStatus, ...]:
        """Return how a component's timers kept their rates."""
        return self._executors[component].timers(self.now)

    def _add_components(
        self,
        robot: Robot,
        placement: Mapping[str, str],
        work: SimulatedWork,
        random: Random,
    ) -> None:
        engine, kinds = self._engine, kinds_together(robot)
        incarnations = [
            Incarnation(component=c, computer=h) for c, h in placement.items()
        ]
        deployments = DeploymentPlan(robot, "").specs(incarnations, 0, {})
        agent = _agent(work.agent)
        for computer in robot.computers:
            self.run(random.uniform(self.now, self.now + _REFILLED_EVERY))
            cores = computer.capacity.get("cpu", _CORES)
            is_emulated = computer.address is None
            cpu = engine.cpu(cores, computer.speed, is_emulated=is_emulated)
            own = engine.container(cpu, computer.name, _nothing, _nothing)
            name = f"agent of {computer.name}"
            executor = own.add((name, 0), 0, agent.made_in(engine), ())
            executor.set_wanted(True)
            executor.activate()
            for spec in deployments[computer.name].containers:
                container = engine.container(cpu, computer.name, _nothing, _nothing)
                container.cpu.weight = spec.weight or _WEIGHT
                connectors = {
                    each.key: work.traffic.connector_in(
                        engine, each, kinds.get(each.name, "local")
                    )
                    for each in spec.connectors
                }
                container.connect(list(connectors.values()))
                for each in spec.components:
                    model = work.models.get(each.name, _USUAL)
                    executor = container.add(
                        (each.name, each.epoch),
                        0,
                        model.made_in(engine, release_offset(each.name)),
                        [(c.name, c.is_first, c.deadline) for c in each.chains],
                    )
                    executor.set_wanted(True)
                    executor.set_leased(False)
                    self._executors[each.name] = executor
                inside = {each.name for each in spec.components}
                for connector in spec.connectors:
                    if connector.source in inside:
                        container.add_sender(connectors[connector.key])


def _agent(cores: float) -> ComponentModel:
    sampling = HandlerModel(work=cores * _SAMPLES_EVERY)
    timer = TimerModel(timer=Timer("sample", _SAMPLES_EVERY), handler=sampling)
    return ComponentModel(timers=(timer,) if cores else ())


def _nothing() -> None:
    """Take no notice."""
