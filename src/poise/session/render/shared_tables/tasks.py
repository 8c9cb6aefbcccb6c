"""Tasks, for people."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator

from rich.markup import escape
from rich.table import Table

from poise.manage.tasks.report import ActionReport, TaskReport
from poise.session.render.shared_tables.columns import table

_COLOURS = {"failed": "red", "waiting": "yellow", "paused": "yellow"}


def task_table(tasks: Iterable[TaskReport]) -> Table:
    """Return tasks with their states and actions."""
    rows = table("task", "state", "since", "priority", "actions", "why", folds=2)
    for each in tasks:
        colour = _COLOURS.get(each.state, "")
        rows.add_row(
            each.name,
            f"[{colour}]{each.state}[/]" if colour else each.state,
            time.strftime("%H:%M:%S", time.localtime(each.since)),
            str(each.priority),
            escape(", ".join(map(_action, each.actions))),
            escape(each.why),
        )
    return rows


def task_lines(tasks: Iterable[TaskReport]) -> Iterator[str]:
    """Yield a line for each task."""
    for each in tasks:
        colour = _COLOURS.get(each.state, "")
        at = f" with {', '.join(map(_action, each.actions))}" if each.actions else ""
        why = f": {each.why}" if each.why else ""
        line = escape(f"task '{each.name}' is {each.state}{at}{why}")
        yield f"[{colour}]{line}[/]" if colour else line


def action_lines(task: TaskReport) -> Iterator[str]:
    """Yield a line for each action of a task whose turn it is."""
    for each in task.actions:
        by = ", ".join(each.architectures) or "nothing yet"
        needs = ", ".join(each.functions) or "no function"
        yield escape(f"{_action(each)}: uses {needs}, provided by {by}")


def _action(action: ActionReport) -> str:
    worked = f" ({action.worked:.1f} s)" if action.is_at_work else ""
    return f"'{action.name}'{worked}"
