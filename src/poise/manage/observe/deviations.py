"""Differences between desired and reported state, and faults that agents report. Pure.

Agents number their faults and keep them for as long as they live, also over robots, so
a reader of new ones remembers the numbers of those before.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from math import inf
from typing import TYPE_CHECKING

from msgspec import Struct

from poise.clock import time_of_day
from poise.errors import last_error
from poise.manage.agent_connections.statuses import (
    Statuses,
    connectors_of,
    why_not_joined,
)
from poise.model.hardware import Computer
from poise.units import format_amount
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
    Fault,
)

if TYPE_CHECKING:
    from poise.manage.deploy.deployment_layout import DeploymentLayout
    from poise.manage.deploy.desired import Incarnation

_MOSTLY = 0.88
"""A computer has at least this share of what it is sold with: the firmware and the
kernel keep some of its memory."""
_CRASH_LOOP = 3
"""Restarts within a minute that make a crash loop."""


class Deviation(Struct, frozen=True, kw_only=True):
    """One thing that is not as it should be."""

    what: str  # a sentence for people; the same for as long as it lasts
    computer: str
    component: str = ""  # empty: it concerns the computer
    container: str = ""  # whose last fault is the cause, and says more; empty: none
    since: float  # when the manager noticed it [s since 1970]

    @property
    def key(self) -> str:
        """What it is about: of two with the same key, the later takes the place."""
        return self.component or self.what

    def end(self) -> str:
        """Return a sentence for when it is over."""
        if self.component:
            return f"component '{self.component}' runs as desired again"
        return f"no more: {self.what}"


def find_deviations(
    settled: Collection[Incarnation],
    names: Mapping[str, AbstractSet[str]],  # as of `wanted_containers`
    layout: DeploymentLayout,
    statuses: Statuses,
    now: float,  # the time [s since 1970]
) -> Iterator[Deviation]:
    """Yield what differs between the placement and what the agents reported."""
    here: dict[str, list[Incarnation]] = defaultdict(list)
    for incarnation in settled:
        here[incarnation.computer].append(incarnation)
    for computer, status in sorted(statuses.items()):
        yield from _of_components(here[computer], layout, status, now)
        for what in _of_computer(layout.computers[computer], status):
            yield Deviation(what=what, computer=computer, since=now)
        for what in _of_containers(names.get(computer, ()), status):
            yield Deviation(what=what, computer=computer, since=now)


def wanted_containers(
    wanted: Iterable[Incarnation], layout: DeploymentLayout
) -> dict[str, set[str]]:
    """Return computer -> the names of the containers that are wanted there."""
    names: dict[str, set[str]] = defaultdict(set)
    for incarnation in wanted:
        names[incarnation.computer].add(layout.container_of(incarnation))
    return names


def find_unwanted(
    names: Mapping[str, AbstractSet[str]], statuses: Statuses, now: float
) -> dict[str, Deviation]:
    """Return the containers that should not run, by what is said of them: some end."""
    found = {}
    for computer, status in sorted(statuses.items()):
        for running in status.containers:
            if running.name not in names.get(computer, ()):
                what = f"container '{running.name}' runs on '{computer}' but should not"
                found[what] = Deviation(what=what, computer=computer, since=now)
    return found


def find_unjoined(
    settled: Collection[Incarnation],
    layout: DeploymentLayout,
    statuses: Statuses,
    now: float,
) -> dict[str, Deviation]:
    """Return the connectors whose source does not reach its target, by name."""
    computers = {incarnation.component: incarnation.computer for incarnation in settled}
    unready = {
        connector.name: connector
        for connector in connectors_of(statuses)
        if connector.end == "source" and not connector.ready
    }
    found = {}
    for connector in layout.connectors(computers) if unready else ():
        if (name := connector.name) in unready:
            source, target = (computers[end.component] for end in connector.between)
            what = why_not_joined(unready[name], source, target, statuses)
            found[name] = Deviation(what=what, computer=source, since=now)
    return found


def _of_components(
    settled: Collection[Incarnation],
    layout: DeploymentLayout,
    status: AgentStatus,
    now: float,
) -> Iterator[Deviation]:
    there = {c.key: c for c in status.components}
    health = {health.name: health for health in status.health}
    for incarnation in settled:
        reported = there.get(incarnation.key)
        if reported is None or reported.state != incarnation.goal:
            container = health.get(layout.container_of(incarnation))
            has_failed = reported is not None and reported.state == "failed"
            is_fault = container and container.last_fault and not has_failed
            yield Deviation(
                what=explain(incarnation, reported, container),
                computer=status.computer,
                component=incarnation.component,
                container=container.name if container and is_fault else "",
                since=now,
            )


def _of_computer(computer: Computer, status: AgentStatus) -> Iterator[str]:
    """Yield what a computer has less of than the robot file says."""
    if computer.address is None:  # what emulates it looks at that itself
        return
    has = {"cpu": status.cores, "memory": float(status.computer_memory)}
    for resource, amount in has.items():
        said = computer.capacity.get(resource, 0.0)
        if 0 < amount < _MOSTLY * said:
            yield (
                f"computer '{computer.name}' has {format_amount(resource, amount)}, "
                f"not the {format_amount(resource, said)} of the robot file: correct "
                f"its `{resource}` there, or too much is placed on it"
            )


def _of_containers(wanted: Container[str], status: AgentStatus) -> Iterator[str]:
    """Yield what is wrong with containers, and with the gateway to them."""
    if status.trouble:
        yield f"on '{status.computer}' {status.trouble}"
    for error in status.errors:
        last = last_error(error.text)
        yield (
            f"agent of '{status.computer}': an internal error in part "
            f'"{error.where}": {last} (traceback in its log); the rest goes on'
        )
    for running in status.containers:
        if running.trouble:
            yield f"on '{status.computer}' {running.trouble}"
    for health in status.health:
        if health.name in wanted and health.restarts_lately >= _CRASH_LOOP:
            where = f"container '{health.name}' on '{status.computer}'"
            yield (
                f"{where} is in a crash loop: restarted at least {_CRASH_LOOP} times "
                "within a minute"
            )


def explain(
    wanted: Incarnation,
    reported: ComponentStatus | None,
    container: ContainerHealth | None,
) -> str:
    """Return what is known of an incarnation that is not as it should be."""
    what = f"component '{wanted.component}' on '{wanted.computer}'"
    if reported is None:
        if container is None or container.state != "restarting":
            return f"{what} does not run"
        return (
            f"{what} does not run: its container "
            f"{container.reason or 'is being restarted'}"
        )
    if reported.state == "unresponsive" and container:
        return f"{what} does not respond: {container.reason}"
    last = last_error(reported.error)
    return f"{what} is {reported.state}" + (f": {last}" if last else "")


Numbers = Mapping[str, int]
"""Computer -> the number of its agent's last fault."""
_FIRST, _WINDOW = 5, 60.0
"""A container with more faults in this time [s] is reported once."""


def last_numbers(statuses: Statuses) -> Numbers:
    """Return the numbers of the last faults that `statuses` hold."""
    return {
        computer: max((fault.number for fault in status.faults), default=0)
        for computer, status in statuses.items()
    }


def faults_after(before: Numbers, statuses: Statuses) -> Iterator[tuple[str, Fault]]:
    """Yield computers and their faults after `before`, oldest first."""
    now = last_numbers(statuses)
    for computer, status in sorted(statuses.items()):
        known = before.get(computer, 0)
        is_new_agent = now[computer] < known
        for fault in status.faults:
            if is_new_agent or fault.number > known:
                yield computer, fault


def fault_sentence(computer: str, fault: Fault) -> str:
    """Return a fault for people."""
    restarts = f" (restarts before: {fault.restarts})" if fault.restarts else ""
    return f"container '{fault.container}' on '{computer}' {fault.message}{restarts}"


def new_faults(before: Numbers, statuses: Statuses) -> list[str]:
    """Return the faults after `before` for people, oldest first."""
    return [fault_sentence(*each) for each in faults_after(before, statuses)]


class FaultFilter:
    """Selects the faults to report: of a container with very many, one a minute.

    `since`: of an agent that is not in `before`, none is reported from before this [s].
    """

    def __init__(self, before: Numbers, since: float = -inf) -> None:
        self.count = 0
        """How many faults there were, reported or not."""
        self._known = before
        self._since = since
        self._of: dict[tuple[str, str], _Faults] = {}

    def new(self, statuses: Statuses, now: float) -> Iterator[tuple[str, Fault]]:
        """Yield the faults to report at `now` [s] with sentences, oldest first."""
        for computer, fault in faults_after(self._known, statuses):
            age = statuses[computer].uptime - fault.uptime
            if computer not in self._known and now - age < self._since:
                continue
            self.count += not fault.is_over
            known = self._of.setdefault((computer, fault.container), _Faults())
            more = known.add(fault, now)
            if known.is_reported:
                yield fault_sentence(computer, fault) + more, fault
        self._known = {**self._known, **last_numbers(statuses)}

    def has_open(self) -> bool:
        """Return whether some fault is not over."""
        return any(not faults.is_over for faults in self._of.values())

    def close(self, computer: str, container: str) -> bool:
        """Take a container's last fault for over; return whether to report that."""
        known = self._of.get((computer, container))
        if known is None or known.is_over:
            return False
        known.is_over = True
        return known.is_reported


class _Faults:
    def __init__(self) -> None:
        self.is_reported = self.is_over = False
        self._moments: deque[float] = deque(maxlen=_FIRST)
        self._reported_at = float("-inf")
        self._unreported = 0

    def add(self, fault: Fault, now: float) -> str:
        """Decide whether to report a fault, and return what to add to its sentence."""
        self.is_over = fault.is_over
        if fault.is_over:  # reported like the fault before, which it ends
            return ""
        self.is_reported = not self._is_many(now) or now - self._reported_at >= _WINDOW
        self._moments.append(now)
        if not self.is_reported:
            self._unreported += 1
            return ""
        more = (
            f"; {self._unreported} more since the last line" if self._unreported else ""
        )
        self._reported_at, self._unreported = now, 0
        return more + ("; from now on one line a minute" if self._is_many(now) else "")

    def _is_many(self, now: float) -> bool:
        return len(self._moments) == _FIRST and now - self._moments[0] < _WINDOW


class LocatedFault(Fault, frozen=True, kw_only=True):
    """A fault, and the computer where it was."""

    computer: str


def combined(faults: Iterable[tuple[str, Fault]]) -> Iterator[str]:
    """Yield a sentence for each kind of fault, with its number and last time."""
    kinds: dict[str, list[Fault]] = {}
    for computer, fault in faults:
        what = f"container '{fault.container}' on '{computer}' {fault.message}"
        kinds.setdefault(what, []).append(fault)
    for what, same in kinds.items():
        last = time_of_day(same[-1].at)
        times = f"{len(same)} times, last at" if len(same) > 1 else "at"
        yield f"{what} ({times} {last})"
