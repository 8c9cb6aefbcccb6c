"""The tasks that an earlier manager left, and how this one goes on with them."""

from __future__ import annotations

import contextlib

from poise.clock import boot_id, boot_time
from poise.decoding import from_msgpack
from poise.errors import UsageError
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.task_progress import Heard, Saved
from poise.manage.tasks.task_reports import OVER
from poise.wire.codec import MALFORMED


def goes_on_with(live: LiveRobot, asked: Tasks, journal: Journal) -> Saved:
    """Return the tasks that go on: those of the manager before, and those asked for."""
    if not live.has_taken_over or not live.desired.tasks:
        return asked.saved
    note = journal.note
    try:
        saved = from_msgpack(live.desired.tasks, Saved)
    except MALFORMED as error:
        note(
            "failed",
            f"the previous manager's tasks cannot be read, and are dropped: {error}",
        )
        with contextlib.suppress(*MALFORMED):  # or it would be heard again
            heard = from_msgpack(live.desired.tasks, Heard).heard
            asked.saved.heard.update(heard)
        return asked.saved
    tasks = Tasks(live.robot, lambda text: note("decided", text), saved=saved)
    for record in list(tasks.records):
        if record.state not in OVER:
            names = ", ".join(f"'{attempt.name}'" for attempt in tasks.tries(record))
            note("decided", f"task '{record.name}' goes on with {names}")
    if saved.boot != boot_id():
        _begin_clocks(tasks, journal)
    for record in asked.records:
        with contextlib.suppress(UsageError):  # it goes on already
            tasks.start(record.name, boot_time(), record.priority)
    return tasks.saved


def _begin_clocks(tasks: Tasks, journal: Journal) -> None:
    """Let actions at work begin now, for another computer's clock says nothing here."""
    now = boot_time()
    for record in tasks.records:
        for attempt in tasks.tries(record):
            if attempt.is_at_work:
                attempt.progress.since = now
                if attempt.action.limit is not None:
                    journal.note(
                        "decided",
                        f"the limit of {attempt.action.limit:g} s of {attempt} counts "
                        f"from now on, less {attempt.progress.spent:g} s: "
                        "its manager ran on another computer, or before this computer "
                        "was restarted",
                    )
