"""What an earlier manager left of its tasks."""

from __future__ import annotations

import contextlib
import time

import msgspec

from poise.errors import UsageError
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.journal import Journal
from poise.manage.tasks.progress import OVER, Saved
from poise.manage.tasks.tasks import Tasks


def goes_on_with(run: RunningComponents, asked: Tasks, journal: Journal) -> Saved:
    """Return the tasks that go on: those of the manager before, and those asked for.

    Parameters
    ----------
    asked
        What this manager was to start; what runs already goes on where it was.
    """
    if not run.desired.tasks:
        return asked.saved
    note = journal.note
    try:
        saved = msgspec.msgpack.decode(run.desired.tasks, type=Saved)
    except msgspec.DecodeError as error:
        note("failed", f"the tasks of the manager before are given up: {error}")
        return asked.saved
    tasks = Tasks(run.robot, lambda text: note("decided", text), saved=saved)
    for record in list(tasks.records):
        if record.state not in OVER:
            names = ", ".join(f"'{each.name}'" for each in tasks.tries(record))
            note("decided", f"task '{record.name}' goes on with {names}")
    for record in asked.records:
        with contextlib.suppress(UsageError):  # it goes on already
            tasks.start(record.name, time.time(), record.priority)
    return tasks.saved
