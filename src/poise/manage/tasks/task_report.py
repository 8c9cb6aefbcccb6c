"""How tasks are, for people and programs."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

from msgspec import Struct

from poise.manage.tasks.task_progress import TaskRecord, TaskState, Try

if TYPE_CHECKING:
    from poise.manage.tasks.concurrent_tasks import Tasks


class ActionReport(Struct, frozen=True, kw_only=True):
    """An action whose turn it is."""

    name: str
    functions: tuple[str, ...]  # what it uses
    architectures: tuple[str, ...]  # what provides that now
    worked: float  # for how long it has worked [s]
    is_at_work: bool  # whether it works now


class TaskReport(Struct, frozen=True, kw_only=True):
    """A task since it was started."""

    name: str
    state: TaskState
    priority: int
    why: str  # what it waits for, or why it ended so; else empty
    began: float  # when it was started, and when its state began [s since 1970]
    since: float  # when it was started, and when its state began [s since 1970]
    actions: tuple[ActionReport, ...] = ()  # those whose turn it is
    next: tuple[str, ...] = ()  # the names of those that may come then


def task_reports(
    tasks: Tasks,
    ahead: Collection[tuple[TaskRecord, Try, float]],
    serving: Callable[[Try], tuple[str, ...]],
    now: float,  # [s], by the clock of `Progress.since`
) -> tuple[TaskReport, ...]:
    """Return how all tasks are, the first started first."""
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
