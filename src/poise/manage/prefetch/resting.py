"""How long components rest, prepared, that no action needs any more.

One that rests costs memory, one that is started again costs CPU. It rests for as long
as the share of its computer's memory that it holds adds up to what its start took, so
that both together cost at most twice what they would if the future were known.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable

from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.prefetch.switch import drop
from poise.model.robot import Architecture

SHORTEST, LONGEST = 10.0, 300.0
"""It rests for so long at least, and at most [s]."""
_START = 0.3
"""A start takes so long where it was not measured [s]."""


class Resting:
    """The components that rest after their actions, and since when."""

    def __init__(self, run: RunningComponents) -> None:
        self._run = run
        self._since: dict[str, float] = {}

    def look(self, kept: Collection[str]) -> None:
        """End what has rested for too long.

        Parameters
        ----------
        kept
            What rests for tasks that wait: it keeps its state.
        """
        run, now = self._run, time.monotonic()
        rests = {n for n, e in run.prepared.items() if not e.gently}
        self._since = {n: self._since.get(n, now) for n in sorted(rests)}
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
                text = f"architecture '{architecture.name}' ends: no action needed it "
                run.journal.note("decided", f"{text}for {limit:.1f} s")
                drop(run, names)

    def oldest_first(self, prepared: Iterable[str]) -> list[str]:
        """Return prepared components: those that only might be needed come first.

        Those that are to rest from now on come last.
        """
        run, now = self._run, time.monotonic()
        known = {name: self._since.get(name, 0.0) for name in run.prepared}
        return sorted(prepared, key=lambda name: known.get(name, now))

    def limit(self, architecture: Architecture) -> float:
        """Return for how long an architecture rests at most [s]."""
        if architecture.linger is not None:
            return architecture.linger
        run = self._run
        names = {c.name for c in architecture.components}
        starts = [c.start for c in components_of(run.current()) if c.name in names]
        start = max(starts, default=0.0) or _START
        capacity = {c.name: c.capacity.get("memory", 0.0) for c in run.robot.computers}
        share = sum(
            c.demand.get("memory", 0.0) / capacity[each.computer]
            for c in architecture.components
            if (each := run.prepared.get(c.name)) and capacity.get(each.computer)
        )
        return min(LONGEST, max(SHORTEST, start / share)) if share else LONGEST
