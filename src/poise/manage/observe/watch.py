"""Journals deviations, faults and errors of a running robot, as they begin and end."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from math import inf

from poise.clock import wall_time
from poise.errors import listed
from poise.manage.agent_connections.statuses import (
    Statuses,
    components_of,
    not_at_goals,
)
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import EntryKind
from poise.manage.observe.deviations import (
    Deviation,
    FaultFilter,
    find_deviations,
    find_unjoined,
    find_unwanted,
    wanted_containers,
)
from poise.manage.observe.troubles import CodeErrors

_TAKE_OVER = 10.0
"""A robot is taken over within this time [s]."""
_LASTS = 2.0
"""A connector that is not joined, or a container that should not run, is a deviation
after this time [s]: it takes a moment to join one, and to end one."""


class Watch:
    """Compares what a run wants with what its agents report."""

    def __init__(self, live: LiveRobot) -> None:
        self.deviations: tuple[Deviation, ...] = ()
        """What is not as it should be now."""
        self._live = live
        self._new: dict[str, tuple[Deviation, float]] = {}
        """What has to last, and since when it is so [s]."""
        # what was before at an agent that is reached late, another manager reported
        since = time.monotonic() - _TAKE_OVER if live.has_taken_over else -inf
        self.faults = FaultFilter(live.faults_before, since)
        self.code_errors = CodeErrors(live.journal.note)
        if live.has_taken_over:
            known = live.current()
            self.code_errors.record(known, time.monotonic(), are_known=True)

    def change(self) -> Iterator[str]:
        """Yield which components are being changed, in words; from any thread."""
        live, current = self._live, self._live.current()
        desired = live.desired
        names = {n for n, placed in desired.placed.items() if placed.goal != "active"}
        starting = [
            each
            for each in desired.configured_ahead
            if each.component not in desired.placed
        ]
        # until its agent has answered, what is idle may as well have rested for long
        resting = [e for e in live.coming_to_rest() if e.computer in current]
        changing = [*desired.coming, *starting, *resting]
        names |= {each.component for each in changing}
        if names:
            what = f"being started, moved, replaced or stopped: {listed(sorted(names))}"
            yield "; ".join([what, *not_at_goals(changing, current, ())])

    def record(self) -> None:
        """Journal each deviation, fault and error when it begins, and when it ends.

        The entry of a container's fault covers the deviation that it caused. A move
        judges the components that it moves.
        """
        live = self._live
        live.note_refused()
        now = time.monotonic()
        for sentence, fault in self.faults.new(live.agents.statuses(), now):
            kind: EntryKind = "right" if fault.is_over else "wrong"
            live.journal.note(kind, sentence, fault=fault)
        reached = live.computers()
        statuses = {c: status for c, status in live.current().items() if c in reached}
        before = {deviation.key: deviation for deviation in self.deviations}
        deviations = self._found(statuses, before, reached - statuses.keys())
        for key, deviation in deviations.items():
            if key in before and before[key].what == deviation.what:
                deviations[key] = before[key]
            elif not deviation.container:
                live.journal.note("wrong", deviation.what)
        for key in sorted(before.keys() - deviations.keys()):
            if not before[key].container:
                live.journal.note("right", before[key].end())
        self.deviations = tuple(deviations.values())
        self.code_errors.record(statuses, now)
        self._note_recoveries(statuses)

    def _found(
        self,
        statuses: Statuses,
        before: Mapping[str, Deviation],
        unheard: AbstractSet[str],
    ) -> dict[str, Deviation]:
        """Return what deviates now, by key; of what is not known now, what did before.

        Not known is what moves, and what is on computers that are `unheard`: they have
        not reported since they were told something else.
        """
        live, now = self._live, wall_time()
        settled = live.desired.settled()
        moving = live.placed.keys() - settled.keys()
        unknown = moving | {
            name for name, each in settled.items() if each.computer in unheard
        }
        current = {
            key: deviation
            for key, deviation in before.items()
            if deviation.component in unknown
            or (deviation.computer in unheard and not deviation.component)
        }
        names = wanted_containers(live.desired.incarnations(), live.layout)
        deviations = find_deviations(
            settled.values(), names, live.layout, statuses, now
        )
        current |= {deviation.key: deviation for deviation in deviations}
        there = [
            incarnation
            for name, incarnation in settled.items()
            if name not in current and incarnation.computer in statuses
        ]
        began, layout = time.monotonic(), live.layout
        joined = layout.connectors(live.placed) if self._new else ()
        still = {
            connector.name
            for connector in joined
            if any(end.component in unknown for end in connector.between)
        }
        found = {
            **{
                key: deviation
                for key, (deviation, _) in self._new.items()
                if key in still or deviation.computer in unheard
            },
            **find_unjoined(there, layout, statuses, now),
            **find_unwanted(names, statuses, now),
        }
        self._new = {
            key: self._new.get(key, (deviation, began))
            for key, deviation in found.items()
        }
        return current | {
            deviation.key: deviation
            for deviation, since in self._new.values()
            if began - since >= _LASTS
        }

    def _note_recoveries(self, statuses: Statuses) -> None:
        """Journal which containers run as they should again after a fault."""
        if not self.faults.has_open():
            return
        live = self._live
        deviating = {
            live.layout.container_of(live.placed[deviation.component])
            for deviation in self.deviations
            if deviation.component in live.placed
        }
        states = {c.key: c.state for c in components_of(statuses)}
        starting = {
            (each.computer, live.layout.container_of(each))
            for each in live.desired.incarnations()
            if states.get(each.key, "unconfigured") == "unconfigured"
        }
        for computer, status in statuses.items():
            for health in status.health:
                is_well = health.state == "running" and health.name not in deviating
                is_well = is_well and (computer, health.name) not in starting
                if is_well and self.faults.close(computer, health.name):
                    what = f"container '{health.name}' on '{computer}'"
                    live.journal.note("right", f"{what} is healthy again")
