"""From the components of some actions to those of the next: at work, or prepared.

A prepared component is configured, inactive and joined to nothing. It keeps its state
and uses memory, but no CPU; it becomes active within moments.

An idle one costs memory, one that is started again costs CPU. It stays for as long as
the share of its computer's memory that it holds adds up to what its start took, so
that both together cost at most twice what they would if the future were known.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Mapping

from msgspec.structs import replace

from poise.errors import RunError
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.running_components import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    DoesNotStart,
    RunningComponents,
)
from poise.model.robot import Architecture


def prepare(
    run: RunningComponents, placement: Mapping[str, str], cpu: Mapping[str, float]
) -> None:
    """Let components be prepared on computers; return before they are.

    What is prepared elsewhere is dropped there; what is at work stays as it is.

    `cpu`: computer -> the CPU time that others leave for it [cores].
    """
    new = [
        _prepared(run, name, computer, gently=True)
        for name, computer in placement.items()
        if name not in run.placed
    ]
    preparation_cpu = {**run.desired.preparation_cpu, **cpu}
    run.commit(
        replace(run.desired, preparation_cpu=preparation_cpu).with_prefetched(new),
        "prepare the next action",
    )


def drop(run: RunningComponents, components: Iterable[str]) -> None:
    """End prepared components; their state is lost."""
    gone = [name for name in components if name in run.prefetched]
    if gone:
        run.commit(run.desired.without(gone), "idle components end")


def switch(
    run: RunningComponents, ends: Collection[str], begins: Mapping[str, str]
) -> bool:
    """Let components rest, prepared, and others begin to work.

    Returns whether all of these were prepared.
    """
    are_ready = _are_ready(run, begins)
    idle = [
        replace(run.placed[name], goal="inactive", unjoined=True, gently=False)
        for name in ends
    ]
    new = [
        replace(_prepared(run, name, at), unjoined=False, gently=False)
        for name, at in begins.items()
    ]
    active = [incarnation.with_goal("active") for incarnation in new]
    desired = run.desired.without([*ends, *begins]).with_prefetched(idle)
    try:
        run.commit(desired.with_coming(new), "switch to the next action")
        _wait(run, [*idle, *new], READY_LIMIT)
        run.commit(run.desired.with_coming(active), "activate the next action")
        _wait(run, active, ACTIVE_LIMIT)
    except RunError as error:
        run.commit(run.desired.with_coming(()), f"it cannot begin: {error}")
        raise
    run.commit(run.desired.placing(active), "the next action is at work")
    return are_ready


def _are_ready(run: RunningComponents, components: Mapping[str, str]) -> bool:
    """Return whether all of some components are prepared where they are to work."""
    return all(
        (idle := run.prefetched.get(name)) is not None
        and idle.computer == computer
        and (found := run.reported(idle)) is not None
        and found.state == "inactive"
        for name, computer in components.items()
    )


def _prepared(
    run: RunningComponents, name: str, computer: str, *, gently: bool = False
) -> Incarnation:
    before = run.prefetched.get(name)
    if before is not None and before.computer == computer:
        found = run.reported(before)
        if found is None or found.state != "failed":
            return before
    return Incarnation(
        component=name,
        computer=computer,
        epoch=run.next_epoch(name),
        goal="inactive",
        gently=gently,
        unjoined=True,
    )


def _wait(
    run: RunningComponents, wanted: Collection[Incarnation], limit: float
) -> None:
    """Wait until components are at their goals; others' troubles do not count."""
    mine = {incarnation.key for incarnation in wanted}

    def trouble() -> bool:
        run.poll()
        for component in components_of(run.agents.statuses()):
            is_mine = (component.name, component.epoch) in mine
            if is_mine and component.state == "failed":
                raise DoesNotStart(component.name, component.error)
        return False

    run.wait(wanted, limit, trouble)


SHORTEST, LONGEST = 10.0, 300.0
"""An idle component stays for so long at least, and at most [s]."""
_START = 0.3
"""A start takes so long where it was not measured [s]."""


class IdleComponents:
    """The components that are idle after their actions, and since when."""

    def __init__(self, run: RunningComponents) -> None:
        self._run = run
        self._since: dict[str, float] = {}

    def drop_expired(self, kept: Collection[str]) -> None:
        """End what has been idle for too long."""
        run, now = self._run, time.monotonic()
        idle = {n for n, e in run.prefetched.items() if not e.gently}
        self._since = {n: self._since.get(n, now) for n in sorted(idle)}
        for architecture in run.robot.architectures:
            names = [
                c.name
                for c in architecture.components
                if c.name in self._since and c.name not in kept
            ]
            if not names:
                continue
            limit = self.limit(architecture)
            if all(now - self._since[name] >= limit for name in names):
                text = f"stopping architecture '{architecture.name}': no action has "
                run.journal.note("decided", f"{text}needed it for {limit:.1f} s")
                drop(run, names)

    def oldest_first(self, prepared: Iterable[str]) -> list[str]:
        """Return prepared components: those that only might be needed come first.

        Those that become idle now come last.
        """
        run, now = self._run, time.monotonic()
        known = {name: self._since.get(name, 0.0) for name in run.prefetched}
        return sorted(prepared, key=lambda name: known.get(name, now))

    def limit(self, architecture: Architecture) -> float:
        """Return for how long an architecture is idle at most [s]."""
        if architecture.linger is not None:
            return architecture.linger
        run = self._run
        names = {c.name for c in architecture.components}
        starts = [c.start for c in components_of(run.current()) if c.name in names]
        start = max(starts, default=0.0) or _START
        capacity = {c.name: c.capacity.get("memory", 0.0) for c in run.robot.computers}
        share = sum(
            c.demand.get("memory", 0.0) / capacity[idle.computer]
            for c in architecture.components
            if (idle := run.prefetched.get(c.name)) and capacity.get(idle.computer)
        )
        return min(LONGEST, max(SHORTEST, start / share)) if share else LONGEST
