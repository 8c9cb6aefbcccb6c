"""How tasks are, for people and programs."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

from msgspec import Struct

from poise.manage.tasks.task_progress import TaskRecord, TaskState, Try

if TYPE_CHECKING:
    from poise.manage.tasks.concurrent_tasks import Tasks


class ActionReport(Struct, frozen=True, kw_only=True):
    """An action whose turn it is.

    Parameters
    ----------
    functions
        What it uses.
    architectures
        What provides that now.
    worked
        For how long it has worked [s].
    is_at_work
        Whether it works now.
    """

    name: str
    functions: tuple[str, ...]
    architectures: tuple[str, ...]
    worked: float
    is_at_work: bool


class TaskReport(Struct, frozen=True, kw_only=True):
    """A task since it was started.

    Parameters
    ----------
    state
        ``going``, ``waiting``, ``paused``, ``done``, ``failed`` or ``cancelled``.
    why
        What it waits for, or why it ended so; else empty.
    began, since
        When it was started, and when its state began [s since 1970].
    actions
        Those whose turn it is.
    next
        The names of those that may come then.
    """

    name: str
    state: TaskState
    priority: int
    why: str
    began: float
    since: float
    actions: tuple[ActionReport, ...] = ()
    next: tuple[str, ...] = ()


def task_reports(
    tasks: Tasks,
    ahead: Collection[tuple[TaskRecord, Try, float]],
    serving: Callable[[Try], tuple[str, ...]],
    now: float,
) -> tuple[TaskReport, ...]:
    """Return how all tasks are, the first started first.

    Parameters
    ----------
    ahead
        The actions that may come next.
    serving
        Returns the architectures that serve an action now.
    now
        [s], by the clock of `Progress.since`.
    """
    return tuple(
        TaskReport(
            name=record.name,
            state=record.state,
            priority=record.priority,
            why=record.why,
            began=record.began,
            since=record.since,
            actions=tuple(
                ActionReport(
                    name=each.name,
                    functions=each.action.functions,
                    architectures=serving(each),
                    worked=tasks.worked(each, now),
                    is_at_work=each.progress.since is not None,
                )
                for each in tasks.tries(record)
            ),
            next=tuple(each.name for of, each, _ in ahead if of is record),
        )
        for record in list(tasks.records)
    )
