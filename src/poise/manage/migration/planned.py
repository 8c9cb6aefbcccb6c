"""A migration that was checked, and whose targets are configured before it begins.

Meanwhile all else goes on: users' code may take long to be imported and configured.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Self

from msgspec import structs

from poise.errors import RunError
from poise.manage.deploy.incarnation import Incarnation
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.coordinator import PREPARE_LIMIT
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.progress_limits import Stall


class Planned:
    """A migration to come. Use it once.

    All but `under_way` is for the manager's thread.

    `targets`: what it can have configured before; none of a cold move.
    """

    def __init__(
        self,
        run: RunningComponents,
        report: MigrationReport,
        targets: tuple[Incarnation, ...],
        migrate: Callable[[], MigrationReport],  # makes it; returns how it went
    ) -> None:
        self._run = run
        self._report = report
        self._targets = tuple(structs.replace(t, unjoined=True) for t in targets)
        self._migrate = migrate
        self._began = 0.0
        self._stall: Stall | None = None
        self._reason = ""
        self._missing: list[str] = []

    def begin(self) -> Self:
        """Let the targets be configured; waits for nothing."""
        self._began = time.monotonic()
        self._stall = Stall(self._run, self._targets)
        desired = self._run.desired.configuring(self._targets)
        self._run.commit(desired, f"configure for the migration of {self._report.name}")
        return self

    def is_over(self) -> bool:
        """Return whether they are configured, or will not be."""
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
        waits = "; ".join(self._missing)
        return f"{self._report.way} has been in preparation for {since:.0f} s: {waits}"

    def run(self) -> MigrationReport:
        """Migrate, or not; never raises for what goes wrong on the way."""
        configured = time.monotonic() - self._began if self._began else 0.0
        if self._reason:
            report = structs.replace(self._report, reason=self._reason)
            desired = self._run.desired.configured(self._targets)
            why = f"migration of {report.name} is not begun: {self._reason}"
            self._run.commit(desired, why)
        else:
            report = self._migrate()
        prepared = configured + report.phases.get("prepare", 0.0)
        report = structs.replace(report, phases={**report.phases, "prepare": prepared})
        report.note_in(self._run.journal)
        return report

    def _is_configured(self) -> bool:
        run = self._run
        run.raise_on_unreached(self._targets)
        run.raise_on_broken(self._targets)
        self._missing = missing = run.missing(self._targets)
        if missing and time.monotonic() > self._began + PREPARE_LIMIT:
            text = f"not there within {PREPARE_LIMIT:g} s: {'; '.join(missing)}"
            raise RunError(text)
        if missing and self._stall is not None:
            self._stall.look()
        return not missing
