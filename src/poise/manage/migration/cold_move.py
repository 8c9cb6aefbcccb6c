"""Moves a command-line component: stops it here and starts it there.

Its process has no state that could be transferred, and must not run twice. So the
target is prepared first; then the component is away for a moment.
"""

from __future__ import annotations

import time

from msgspec import structs

from poise.errors import RunError
from poise.manage.deployment import Incarnation
from poise.manage.migration.coordinator import MigrationReport
from poise.manage.run import ACTIVE_LIMIT, READY_LIMIT, Run


def cold_move(run: Run, old: Incarnation, new: Incarnation) -> MigrationReport:
    """Stop `old` and start `new`, or `old` again; never raises for a failure.

    ``downtime`` is how long it was away [s].
    """
    started = time.monotonic()
    others = [each for each in run.placed.values() if each != old]
    try:
        try:
            run.tell([*others, old, new.with_goal("inactive")], run.computers())
            run.wait([new.with_goal("inactive")], READY_LIMIT)
        except RunError as error:
            run.tell(run.placed.values(), run.computers())
            seconds = time.monotonic() - started
            return MigrationReport(reason=str(error), phases={"prepare": seconds})
        stopped = time.monotonic()
        reason = _swap(run, others, old, new)
    except RunError as error:
        return MigrationReport(reason=f"telling what should run: {error}")
    return MigrationReport(
        committed=not reason,
        reason=reason,
        downtime=time.monotonic() - stopped,
        phases={"prepare": stopped - started},
    )


def _swap(
    run: Run, others: list[Incarnation], old: Incarnation, new: Incarnation
) -> str:
    """Return why `old` runs again; empty: `new` runs."""
    active = new.with_goal("active")
    try:
        run.tell([*others, new.with_goal("inactive")], run.computers())
        run.wait_ended(old)
        run.tell([*others, active], run.computers())
        run.wait([active], ACTIVE_LIMIT)
    except RunError as error:
        again = structs.replace(old, epoch=run.next_epoch(old.component))
        run.placed[old.component] = again
        run.tell(run.placed.values(), run.computers())
        return str(error)
    run.placed[new.component] = active
    return ""
