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
from poise.manage.deploy.live_robot import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    DoesNotStart,
    LiveRobot,
)
from poise.model.robot import Architecture


def prepare(
    live: LiveRobot, placement: Mapping[str, str], cpu: Mapping[str, float]
) -> None:
    """Let components be prepared on computers; return before they are.

    What is prepared elsewhere is dropped there; what is at work stays as it is.

    `cpu`: computer -> the CPU time that others leave for it [cores].
    """
    new = [
        _prepared(live, name, computer, gently=True)
        for name, computer in placement.items()
        if name not in live.placed
    ]
    preparation_cpu = {**live.desired.preparation_cpu, **cpu}
    live.commit(
        replace(live.desired, preparation_cpu=preparation_cpu).with_prefetched(new),
        "prepare the next action",
    )


def drop(live: LiveRobot, components: Iterable[str]) -> None:
    """End prepared components; their state is lost."""
    gone = [name for name in components if name in live.prefetched]
    if gone:
        live.commit(live.desired.without(gone), "idle components end")


def switch(live: LiveRobot, ends: Collection[str], begins: Mapping[str, str]) -> bool:
    """Let components rest, prepared, and others begin to work.

    Returns whether all of these were prepared.
    """
    are_ready = _are_ready(live, begins)
    idle = [
        replace(live.placed[name], goal="inactive", unjoined=True, gently=False)
        for name in ends
    ]
    new = [
        replace(_prepared(live, name, at), unjoined=False, gently=False)
        for name, at in begins.items()
    ]
    desired = live.desired.without([*ends, *begins]).with_prefetched(idle)
    try:
        live.commit(desired.with_coming(new), "switch to the next action")
        _wait(live, [*idle, *new], READY_LIMIT)
        live.end_left_behind(new)
        # what is at work on a computer that was joined meanwhile goes on
        active = [e.with_goal("active") for e in new if e.component not in live.placed]
        live.commit(live.desired.with_coming(active), "activate the next action")
        _wait(live, active, ACTIVE_LIMIT)
    except RunError as error:
        live.commit(live.desired.with_coming(()), f"it cannot begin: {error}")
        raise
    live.commit(live.desired.placing(active), "the next action is at work")
    return are_ready


def _are_ready(live: LiveRobot, components: Mapping[str, str]) -> bool:
    """Return whether all of some components are prepared where they are to work."""
    return all(
        (idle := live.prefetched.get(name)) is not None
        and idle.computer == computer
        and (found := live.reported(idle)) is not None
        and found.state == "inactive"
        for name, computer in components.items()
    )


def _prepared(
    live: LiveRobot, name: str, computer: str, *, gently: bool = False
) -> Incarnation:
    before = live.prefetched.get(name)
    if before is not None and before.computer == computer:
        found = live.reported(before)
        if found is None or found.state != "failed":
            return before
    new = live.begun(name, computer)
    return replace(new, goal="inactive", gently=gently, unjoined=True)


def _wait(live: LiveRobot, wanted: Collection[Incarnation], limit: float) -> None:
    """Wait until components are at their goals; others' troubles do not count."""
    mine = {incarnation.key for incarnation in wanted}

    def trouble() -> bool:
        live.poll()
        for component in components_of(live.agents.statuses()):
            is_mine = (component.name, component.epoch) in mine
            if is_mine and component.state == "failed":
                raise DoesNotStart(component.name, component.error)
        return False

    live.wait(wanted, limit, trouble)


SHORTEST, LONGEST = 10.0, 300.0
"""An idle component stays for so long at least, and at most [s]."""
_START = 0.3
"""A start takes so long where it was not measured [s]."""


class IdleComponents:
    """The components that are idle after their actions, and since when."""

    def __init__(self, live: LiveRobot) -> None:
        self._live = live
        self._since: dict[str, float] = {}

    def drop_expired(self, kept: Collection[str]) -> None:
        """End what has been idle for too long."""
        live, now = self._live, time.monotonic()
        idle = {n for n, e in live.prefetched.items() if not e.gently}
        self._since = {n: self._since.get(n, now) for n in sorted(idle)}
        for architecture in live.robot.architectures:
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
                live.journal.note("decided", f"{text}needed it for {limit:.1f} s")
                drop(live, names)

    def oldest_first(self, prepared: Iterable[str]) -> list[str]:
        """Return prepared components: those that only might be needed come first.

        Those that become idle now come last.
        """
        live, now = self._live, time.monotonic()
        known = {name: self._since.get(name, 0.0) for name in live.prefetched}
        return sorted(prepared, key=lambda name: known.get(name, now))

    def limit(self, architecture: Architecture) -> float:
        """Return for how long an architecture is idle at most [s]."""
        if architecture.linger is not None:
            return architecture.linger
        live = self._live
        names = {c.name for c in architecture.components}
        starts = [c.start for c in components_of(live.current()) if c.name in names]
        start = max(starts, default=0.0) or _START
        capacity = {c.name: c.capacity.get("memory", 0.0) for c in live.robot.computers}
        share = sum(
            c.demand.get("memory", 0.0) / capacity[idle.computer]
            for c in architecture.components
            if (idle := live.prefetched.get(c.name)) and capacity.get(idle.computer)
        )
        return min(LONGEST, max(SHORTEST, start / share)) if share else LONGEST
