"""What of the time that chains and timers take can be summed, as time limits."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from poise.estimate.demands import kinds_together
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.model.robot import Chain, Connector, Robot
from poise.plan import Hop, Run, TimeLimit
from poise.plan.from_robot import LATENESS_PRICE
from poise.simulation.component_models import HandlerModel
from poise.simulation.workload import SimulatedWork


def chain_limits(robot: Robot, work: SimulatedWork) -> Iterator[TimeLimit]:
    """Yield what the data of each chain passes from end to end."""
    paths = _Paths(robot, work)
    for chain in robot.chains:
        yield TimeLimit(
            name=chain.name,
            limit=chain.deadline,
            runs=tuple(
                Run(component=name, seconds=handler.work)
                for name, handler in paths.runs(chain)
            ),
            hops=tuple(
                hop
                for source, target in pairwise(chain.through)
                for hop in paths.hops(source, target)
            ),
            shared=True,
        )


def timer_limits(work: SimulatedWork) -> Iterator[TimeLimit]:
    """Yield what a run of each timer with a deadline takes, apart from its waiting."""
    for component, model in work.models.items():
        for each in model.timers:
            if each.timer.deadline is not None:
                yield TimeLimit(
                    name=f"{component}.{each.timer.name}",
                    limit=each.timer.deadline,
                    runs=(Run(component=component, seconds=each.handler.work),),
                    shared=True,
                    price=LATENESS_PRICE,
                )


class _Paths:
    """Finds the runs and connectors that data passes."""

    def __init__(self, robot: Robot, work: SimulatedWork) -> None:
        self._work = work
        self._slot_of = DeploymentLayout(robot, "").slot_of
        self._kinds = kinds_together(robot)
        self._between: dict[frozenset[str], Connector] = {}
        for connector in robot.all_connectors():
            ends = frozenset(end.component for end in connector.between)
            self._between.setdefault(ends, connector)

    def runs(self, chain: Chain) -> Iterator[tuple[str, HandlerModel]]:
        """Yield components and the handlers that the data goes through, each once."""
        for component in chain.through[1:]:
            handlers = [
                handler
                for pair in pairwise(chain.through)
                if component in pair
                for handler in self._at(component, *pair)
            ]
            for handler in {id(each): each for each in handlers}.values():
                yield component, handler

    def hops(self, source: str, target: str) -> Iterator[Hop]:
        """Yield the way of data between two components."""
        connector = self._between.get(frozenset((source, target)))
        if connector is not None:
            name, traffic = str(connector), self._work.traffic
            share = 2 if name in traffic.calling else 1  # a call goes both ways
            yield Hop(
                between=(source, target),
                seconds=traffic.apart(name, self._kinds[name]),
                size=traffic.size_of(name) / share,
            )

    def _at(self, component: str, source: str, target: str) -> Iterator[HandlerModel]:
        """Yield the handlers of a component that send data on, or that take it."""
        connector = self._between.get(frozenset((source, target)))
        model = self._work.models.get(component)
        if connector is None or model is None:
            return
        slot = self._slot_of(connector)
        if connector.between[0].component == component:  # it publishes or calls
            timers = (each.handler for each in model.timers)
            for handler in (*timers, *model.takes.values(), *model.serves.values()):
                if slot in handler.calls or slot in (handler.publishes or {}):
                    yield handler
        else:
            found = model.takes.get(slot) or model.serves.get(slot)
            yield found or model.other
