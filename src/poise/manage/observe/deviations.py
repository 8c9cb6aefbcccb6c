"""What is not as the manager wants it, by what the agents reported. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from collections.abc import Set as AbstractSet
from typing import TYPE_CHECKING

from msgspec import Struct

from poise.manage.agent_connections.statuses import (
    Statuses,
    components_of,
    connectors_of,
)
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
)

if TYPE_CHECKING:
    from poise.manage.deploy.deployment_plan import DeploymentPlan
    from poise.manage.deploy.incarnation import Incarnation

_CRASH_LOOP = 3
"""Restarts within a minute that make a crash loop."""


class Deviation(Struct, frozen=True, kw_only=True):
    """One thing that is not as it should be."""

    what: str  # a sentence for people; the same for as long as it lasts
    computer: str  # where; `component` is empty when it concerns the computer
    component: str = ""  # where; `component` is empty when it concerns the computer
    # the container whose last fault is the cause, and says more; empty: none
    container: str = ""
    since: float  # when the manager noticed it [s since 1970]

    @property
    def key(self) -> str:
        """What it is about: of two with the same key, the later takes the place."""
        return self.component or self.what

    def end(self) -> str:
        """Return a sentence for when it is over."""
        if self.component:
            return f"component '{self.component}' is as it should be again"
        return f"no more: {self.what}"


def find_deviations(
    settled: Collection[Incarnation],
    wanted: Collection[Incarnation],
    layout: DeploymentPlan,
    statuses: Statuses,
    now: float,  # the time [s since 1970]
) -> Iterator[Deviation]:
    """Yield what differs between the placement and what the agents reported."""
    for computer, status in sorted(statuses.items()):
        here = [each for each in settled if each.computer == computer]
        yield from _of_components(here, layout, status, now)
        names = {
            layout.container_of(e.component) for e in wanted if e.computer == computer
        }
        for what in _of_containers(names, status):
            yield Deviation(what=what, computer=computer, since=now)


def find_unjoined(
    settled: Collection[Incarnation],
    layout: DeploymentPlan,
    statuses: Statuses,
    now: float,
) -> Iterator[tuple[str, Deviation]]:
    """Yield the connectors whose source does not reach its target, by name."""
    computers = {each.component: each.computer for each in settled}
    unready = {
        connector.name
        for connector in connectors_of(statuses)
        if connector.end == "source" and not connector.ready
    }
    if not unready:
        return
    for connector in layout.connectors(computers):
        if (name := connector.name) in unready:
            source, target = (computers[end.component] for end in connector.between)
            what = f"connector '{name}' from '{source}' does not reach '{target}'"
            yield name, Deviation(what=what, computer=source, since=now)


def _of_components(
    settled: Collection[Incarnation],
    layout: DeploymentPlan,
    status: AgentStatus,
    now: float,
) -> Iterator[Deviation]:
    there = {(c.name, c.epoch): c for c in components_of({status.computer: status})}
    health = {each.name: each for each in status.health}
    for each in settled:
        found = there.get((each.component, each.epoch))
        if found is None or found.state != each.goal:
            container = health.get(layout.container_of(each.component))
            has_failed = found is not None and found.state == "failed"
            is_fault = container and container.last_fault and not has_failed
            yield Deviation(
                what=explain(each, found, container),
                computer=status.computer,
                component=each.component,
                container=container.name if container and is_fault else "",
                since=now,
            )


def _of_containers(wanted: AbstractSet[str], status: AgentStatus) -> Iterator[str]:
    """Yield what is wrong with containers, and with the gateway to them."""
    if status.trouble:
        yield f"on '{status.computer}' {status.trouble}"
    for error in status.errors:
        last = error.text.rstrip().rpartition("\n")[2]
        yield (
            f"agent of '{status.computer}': an error of Poise in its part "
            f'"{error.where}": {last} (traceback in its log); the rest goes on'
        )
    for running in status.containers:
        if running.trouble:
            yield f"on '{status.computer}' {running.trouble}"
        if running.name not in wanted:
            yield f"container '{running.name}' runs on '{status.computer}', unwanted"
    for each in status.health:
        if each.name in wanted and each.restarts_lately >= _CRASH_LOOP:
            where = f"container '{each.name}' on '{status.computer}'"
            yield (
                f"{where} is in a crash loop: restarted at least {_CRASH_LOOP} times "
                "within a minute"
            )


def explain(
    wanted: Incarnation,
    found: ComponentStatus | None,
    container: ContainerHealth | None,
) -> str:
    """Return what is known of an incarnation that is not as it should be."""
    what = f"component '{wanted.component}' on '{wanted.computer}'"
    if found is None:
        is_restarting = container is not None and container.state == "restarting"
        return f"{what} does not run" + (
            ": its container is being restarted" if is_restarting else ""
        )
    if found.state == "unresponsive" and container:
        return f"{what} does not respond: {container.reason}"
    last = found.error.rstrip().rpartition("\n")[2]
    return f"{what} is {found.state}" + (f": {last}" if last else "")
