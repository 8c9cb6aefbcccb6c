"""A migration that was checked, and whose targets are configured before it begins."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Self

from msgspec import structs

from poise.errors import RunError
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.observe.deviations import combined, faults_after, last_numbers

PREPARE_LIMIT = 30.0
"""The targets are configured, and have a large state, within this time [s]."""
STALL_LIMIT = 2.0
"""A preparation that makes no progress for so long has failed [s]."""


class Stall:
    """Notices when nothing goes on any more, or ends. Use it for one preparation."""

    def __init__(
        self,
        live: LiveRobot,
        clock: Callable[[], float] = time.monotonic,  # a time that never goes back [s]
    ) -> None:
        self._live = live
        self._missing: list[str] = []
        self._clock = clock
        self._since = clock()
        self._faults_before = last_numbers(live.agents.statuses())

    def check(self, missing: list[str], wanted: Collection[Incarnation]) -> None:
        """Raise RunError when nothing comes nearer for long, or a container ends.

        Users' code that is imported or configured may take longer than `STALL_LIMIT`.
        `missing`: what is waited for, in words.
        """
        self._raise_on_faults(wanted)
        now = self._clock()
        if missing != self._missing or self._is_configuring(wanted):
            self._missing, self._since = missing, now
        elif now > self._since + STALL_LIMIT:
            text = f"no progress for {STALL_LIMIT:g} s"
            raise RunError(f"{text}: {'; '.join(missing)}")

    def _raise_on_faults(self, wanted: Collection[Incarnation]) -> None:
        places = set(map(self._live.layout.container_at, wanted))
        later = faults_after(self._faults_before, self._live.agents.statuses())
        if faults := [
            (computer, fault)
            for computer, fault in later
            if (computer, fault.container) in places and not fault.is_over
        ]:
            raise RunError("; ".join(combined(faults)))

    def _is_configuring(self, wanted: Collection[Incarnation]) -> bool:
        """Return whether one is being started, imported or configured."""
        current = self._live.current()
        places = set(map(self._live.layout.container_at, wanted))
        states = {c.key: c.state for c in components_of(current)}
        return any(states.get(w.key) == "unconfigured" for w in wanted) or any(
            health.state == "starting" and (computer, health.name) in places
            for computer, status in current.items()
            for health in status.health
        )


class PendingMigration:
    """A migration to be run when its targets are configured. Use it once.

    All but `under_way` is for the manager's thread.

    `targets`: what it can have configured before; none of a cold move.
    `sources`: what has to be at work when it begins, or its state cannot be had. After
    a short cut an agent lets it rest until it is sent a deployment.
    """

    def __init__(
        self,
        live: LiveRobot,
        report: MigrationReport,
        sources: tuple[Incarnation, ...],
        targets: tuple[Incarnation, ...],
        migrate: Callable[[], MigrationReport],  # makes it; returns how it went
    ) -> None:
        self._live = live
        self._report = report
        self._sources = {source.key: source for source in sources}
        self._targets = tuple(structs.replace(t, unjoined=True) for t in targets)
        self._migrate = migrate
        self._began = 0.0
        self._stall: Stall | None = None
        self._reason = ""
        self._missing: list[str] = []
        self._runs = False

    def configure_ahead(self) -> Self:
        """Let the targets be configured; waits for nothing."""
        self._began = time.monotonic()
        self._stall = Stall(self._live)
        desired = self._live.desired.with_configured_ahead(self._targets)
        self._live.commit(
            desired, f"configure for the migration of {self._report.name}"
        )
        return self

    def is_decided(self) -> bool:
        """Look; return whether they are configured, or will not be."""
        if self._reason:
            return True
        try:
            return self._is_configured()
        except RunError as error:
            self._reason = str(error)
            return True

    def under_way(self) -> str:
        """Return what is waited for, in words; from any thread."""
        since = time.monotonic() - self._began
        if self._runs:
            return f"{self._report.way} has been under way for {since:.0f} s"
        waits = "; ".join(self._missing)
        return f"{self._report.way} has been in preparation for {since:.0f} s: {waits}"

    def run(self) -> MigrationReport:
        """Migrate, or not, as `Migration.run` says."""
        self._runs = True
        configured = time.monotonic() - self._began if self._began else 0.0
        if self._reason:
            report = structs.replace(self._report, reason=self._reason)
            desired = self._live.desired.without_configured_ahead(self._targets)
            why = f"migration of {report.name} was not started: {self._reason}"
            self._live.commit(desired, why)
        else:
            report = self._migrate()
        prepared = configured + report.phases.get("prepare", 0.0)
        report = structs.replace(report, phases={**report.phases, "prepare": prepared})
        report.note_in(self._live.journal)
        if report.committed:
            return report
        # another change may have come first
        placed = self._live.placement()
        now = {name: placed[name] for name in report.before if name in placed}
        return structs.replace(report, before=now or report.before)

    def _is_configured(self) -> bool:
        live = self._live
        live.raise_on_broken(self._targets)
        self._missing = missing = self._unmet()
        if missing and time.monotonic() > self._began + PREPARE_LIMIT:
            text = f"not ready within {PREPARE_LIMIT:g} s: {'; '.join(missing)}"
            raise RunError(text)
        if missing and self._stall is not None:
            self._stall.check(missing, self._targets)
        return not missing

    def _unmet(self) -> list[str]:
        """Return what it waits for, in words: targets, and sources that rest."""
        ends = (*self._sources.values(), *self._targets)
        unsure = [
            f"computer '{computer}' is not heard, or was cut off"
            for computer in sorted({end.computer for end in ends})
            if not self._live.agents.heartbeats.is_sure(computer)
        ]
        resting = (
            self._sources.get(component.key)
            for component in components_of(self._live.agents.statuses())
            if component.state == "inactive" and component.name in self._live.placed
        )
        unjoined = (structs.replace(s, unjoined=True) for s in resting if s is not None)
        return unsure + self._live.missing([*self._targets, *unjoined])
