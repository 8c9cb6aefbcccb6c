"""From what the loop knows to the values that policies ask of each subject. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from poise.manage.adaptation.bad_links import link_values
from poise.manage.adaptation.decision import shortages_of
from poise.manage.adaptation.facts import Facts
from poise.model.policy.values import (
    ChainValues,
    ComponentValues,
    ComputerValues,
    ContainerValues,
    RobotValues,
    Subject,
    Values,
)


def values_of(facts: Facts, subject: Subject) -> tuple[Values, ...]:
    """Return the values of all subjects of a kind."""
    return tuple(_READ[subject](facts))


def _computers(facts: Facts) -> Iterator[Values]:
    shortages = shortages_of(facts)
    for computer in facts.robot.computers:
        load = facts.loads.get(computer.name)
        status = facts.statuses.get(computer.name)
        here = [n for n, at in facts.placement.items() if at == computer.name]
        yield ComputerValues(
            name=computer.name,
            lost=computer.name in facts.lost,
            capacity=computer.total("cpu"),
            used=load.used if load else 0.0,
            background=load.background if load else 0.0,
            full=load is not None and load.is_full,
            starved=max(
                (
                    each.estimate.starved
                    for each in facts.demand_estimates
                    if each.computer == computer.name
                ),
                default=0.0,
            ),
            late=sum(e.late for e in facts.misses if e.computer == computer.name),
            drifted=sum(
                e.estimate.drift is not None and e.computer == computer.name
                for e in facts.demand_estimates
            ),
            short=shortages[computer.name],
            memory=status.memory if status else 0.0,
            components=len(here),
        )


def _components(facts: Facts) -> Iterator[Values]:
    states = {
        (computer, component.name): (component, container)
        for computer, status in facts.statuses.items()
        for container in status.containers
        for component in container.components
    }
    memory = {
        (computer, health.name): health.memory
        for computer, status in facts.statuses.items()
        for health in status.health
    }
    demands = {each.component: each.estimate for each in facts.demand_estimates}
    for architecture in facts.robot.architectures:
        for entry in architecture.components:
            if (computer := facts.placement.get(entry.name)) is None:
                continue
            demand = demands.get(entry.name)
            component, container = states.get((computer, entry.name), (None, None))
            yield ComponentValues(
                name=entry.name,
                computer=computer,
                architecture=architecture.name,
                priority=architecture.priority,
                state=component.state if component else "gone",
                cpu=demand.mean if demand else 0.0,
                expected=entry.demand.get("cpu", 0.0),
                starved=demand.starved if demand else 0.0,
                hung=component.hung if component else 0.0,
                errors=component.errors if component else 0,
                memory=memory.get((computer, container.name), 0.0)
                if container
                else 0.0,
            )


def _containers(facts: Facts) -> Iterator[Values]:
    for computer, status in facts.statuses.items():
        for health in status.health:
            yield ContainerValues(
                name=health.name,
                computer=computer,
                state=health.state,
                restarts=health.restarts,
                restarts_lately=health.restarts_lately,
                cpu=health.cpu,
                memory=health.memory,
            )


def _chains(facts: Facts) -> Iterator[Values]:
    for each in facts.chains:
        yield ChainValues(
            name=each.chain,
            component=each.last,
            computer=each.computers[each.slowest],
            age=each.ages[each.last],
            deadline=each.deadline,
            used=each.used,
            missed=each.missed,
            share=each.missed / each.used,
            over=each.seconds,
            late=each.is_late,
            steps=str(each),
        )


def _robots(facts: Facts) -> Iterator[Values]:
    yield RobotValues(
        name=facts.robot.name,
        lost=len(facts.lost),
        late=sum(each.late for each in facts.misses),
        used=sum(load.used for load in facts.loads.values()),
        calls=sum(each.calls + each.messages for each in facts.traffic.values()),
    )


_READ: Mapping[Subject, Callable[[Facts], Iterator[Values]]] = {
    "computer": _computers,
    "link": link_values,
    "component": _components,
    "container": _containers,
    "timer": lambda facts: iter(facts.misses),
    "chain": _chains,
    "robot": _robots,
}
