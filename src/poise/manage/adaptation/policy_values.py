"""From what the loop knows to the values that policies ask of each subject. Pure.

What is not known now is no number: no comparison with it holds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from math import nan

from poise.manage.adaptation.bad_links import link_values
from poise.manage.adaptation.decision import shortages_of
from poise.manage.adaptation.situation import Situation
from poise.manage.observe.estimates import DemandEstimate, culprit_on
from poise.model.policy import (
    ChainValues,
    ComponentValues,
    ComputerValues,
    ContainerValues,
    RobotValues,
    Subject,
    Values,
)
from poise.wire.records.status_records import AgentStatus


def values_of(situation: Situation, subject: Subject) -> tuple[Values, ...]:
    """Return the values of all subjects of a kind."""
    return tuple(_READ[subject](situation))


def _computers(situation: Situation) -> Iterator[Values]:
    shortages = shortages_of(situation)
    estimates: dict[str, list[DemandEstimate]] = {}
    for each in situation.estimates_at_work():
        estimates.setdefault(each.computer, []).append(each)
    components = Counter(situation.placement.values())
    late = Counter(timer.computer for timer in situation.misses if timer.late)
    by_name = {each.component: each for each in situation.demand_estimates}
    for computer in situation.robot.computers:
        is_known = computer.name not in situation.unreached
        here = estimates.get(computer.name, ()) if is_known else ()
        load = situation.loads.get(computer.name) if is_known else None
        status = situation.statuses.get(computer.name) if is_known else None
        running = [by_name[n] for n in load.components if n in by_name] if load else ()
        yield ComputerValues(
            name=computer.name,
            lost=computer.name in situation.lost,
            capacity=computer.total("cpu"),
            used=load.used if load else nan,
            background=load.background if load else nan,
            full=load is not None and load.is_full,
            starved=max([each.estimate.starved for each in here], default=0.0)
            if is_known
            else nan,
            late=late[computer.name],
            drifted=sum([each.estimate.drift is not None for each in here]),
            short=shortages[computer.name],
            culprit=culprit_on(load, running)
            or "nothing takes more than was expected there"
            if load
            else "its use is not known",
            memory=status.memory if status else nan,
            components=components[computer.name],
        )


def _components(situation: Situation) -> Iterator[Values]:
    statuses = _current(situation)
    states = {
        (computer, component.name): (component, container.name)
        for computer, status in statuses.items()
        for container in status.containers
        for component in container.components
    }
    memory = {
        (computer, health.name): health.memory
        for computer, status in statuses.items()
        for health in status.health
    }
    demands = {each.component: each.estimate for each in situation.demand_estimates}
    for architecture in situation.robot.architectures:
        for entry in architecture.components:
            if (computer := situation.placement.get(entry.name)) is None:
                continue
            demand = demands.get(entry.name)
            now = demand if computer not in situation.unreached else None
            component, container = states.get((computer, entry.name), (None, ""))
            yield ComponentValues(
                name=entry.name,
                computer=computer,
                architecture=architecture.name,
                priority=architecture.priority,
                state=component.state if component else "gone",
                cpu=demand.mean if demand else nan,
                expected=entry.demand.get("cpu", 0.0),
                starved=now.starved if now else nan,
                hung=component.hung if component else nan,
                long_job=now.long_job if now else nan,
                errors=component.errors if component else 0,
                memory=memory.get((computer, container), nan),
            )


def _containers(situation: Situation) -> Iterator[Values]:
    demands = situation.robot.demands("memory")
    for computer, status in _current(situation).items():
        inside = {
            container.name: container.components for container in status.containers
        }
        for health in status.health:
            components = inside.get(health.name, ())
            # what a component allocates in `configure` is no leak
            is_starting = "unconfigured" in [c.state for c in components]
            yield ContainerValues(
                name=health.name,
                computer=computer,
                state=health.state,
                reason=health.reason,
                restarts=health.restarts,
                restarts_lately=health.restarts_lately,
                cpu=health.cpu,
                memory=health.memory,
                components=", ".join([c.name for c in components]),
                expected=sum([demands.get(c.name, 0.0) for c in components]),
                growth=0.0 if is_starting else health.growth,
                limit=health.limit,
                full_in=health.full_in,
            )


def _chains(situation: Situation) -> Iterator[Values]:
    for chain in situation.chains:
        yield ChainValues(
            name=chain.chain,
            component=chain.last,
            computer=chain.computers[chain.slowest],
            age=chain.ages[chain.last],
            deadline=chain.deadline,
            used=chain.used,
            missed=chain.missed,
            share=chain.missed / chain.used,
            over=chain.seconds,
            late=chain.is_late,
            steps=str(chain),
        )


def _robots(situation: Situation) -> Iterator[Values]:
    placement, gone = situation.placement, situation.unreached
    sources = {
        each.name: each.between[0].component
        for each in situation.robot.all_connectors()
    }
    loads = [load.used for name, load in situation.loads.items() if name not in gone]
    yield RobotValues(
        name=situation.robot.name,
        lost=len(situation.lost),
        late=sum(timer.late for timer in situation.misses),
        used=sum(loads) if loads else nan,
        calls=sum(
            traffic.rate
            for name, traffic in situation.traffic.items()
            if placement.get(sources.get(name, "")) not in gone
        ),
    )


def _current(situation: Situation) -> Mapping[str, AgentStatus]:
    """Return the statuses of computers that are reached."""
    statuses, gone = situation.statuses, situation.unreached
    return {name: status for name, status in statuses.items() if name not in gone}


_READ: Mapping[Subject, Callable[[Situation], Iterator[Values]]] = {
    "computer": _computers,
    "link": link_values,
    "component": _components,
    "container": _containers,
    "timer": lambda situation: iter(situation.misses),
    "chain": _chains,
    "robot": _robots,
}
