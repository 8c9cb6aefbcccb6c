"""What an earlier manager left of its tasks."""

from __future__ import annotations

import contextlib

import msgspec

from poise.clock import boot_id, boot_time
from poise.errors import UsageError
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.journal import Journal
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.task_progress import OVER, Saved


def goes_on_with(run: RunningComponents, asked: Tasks, journal: Journal) -> Saved:
    """Return the tasks that go on: those of the manager before, and those asked for.

    `asked`: what this manager was to start; what runs already goes on where it was.
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
        for each in tasks.tries(record):
            if each.progress.since is not None:
                each.progress.since = now
                if each.action.limit is not None:
                    journal.note(
                        "decided",
                        f"action '{each.name}' of task '{record.name}' has its limit "
                        f"of {each.action.limit:g} s from now on, less "
                        f"{each.progress.spent:g} s: its manager ran on another "
                        "computer, or before this one was started again",
                    )
