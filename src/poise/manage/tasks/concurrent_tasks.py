"""Several tasks at once: which of them may run now, and how they are. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator

from msgspec.structs import replace

from poise.clock import wall_time_at
from poise.errors import UsageError, did_you_mean
from poise.manage.tasks.task_progress import (
    ActionEnded,
    Attempt,
    Choose,
    Progress,
    Saved,
    Steps,
    TaskRecord,
)
from poise.manage.tasks.task_reports import OVER, ActionReport, TaskReport, TaskState
from poise.model.phases import clashes
from poise.model.robot import Robot
from poise.model.steps import Until
from poise.units import named

_SAYINGS = {
    "paused": "is paused",
    "done": "is done",
    "failed": "is given up",
    "cancelled": "is cancelled",
}
_HALTED = {*OVER, "paused"}
MOST_OVER = 20
"""So many tasks that are over are remembered."""


class Tasks:
    """The tasks of a robot that were started; `now` is a time [s] that never steps."""

    def __init__(
        self,
        robot: Robot,
        say: Callable[[str], object] = lambda _: None,
        choose: Choose = lambda *_: 0,
        saved: Saved | None = None,
        wall: Callable[[float], float] = wall_time_at,  # `now` -> [s since 1970]
    ) -> None:
        self._robot = robot
        self._tasks = {task.name: task for task in robot.tasks}
        self._say = say
        self._wall = wall
        self._steps = {
            name: Steps(self._tasks, name, choose, self._next, say)
            for name in self._tasks
        }
        self.saved = saved or Saved()
        self._blocked: dict[str, str] = {}
        self._ended: list[ActionEnded] = []
        self._announced = {r.order: (r.state, r.why) for r in self.saved.records}
        for record in list(self.saved.records):
            steps = self._steps.get(record.name)
            if steps is None or not steps.fit(record.progress):
                self.saved.records.remove(record)
                lacks = "it" if steps is None else "these steps"
                text = f"is dropped: the robot file no longer has {lacks}"
                say(f"task '{record.name}' {text}")

    @property
    def records(self) -> list[TaskRecord]:
        """All tasks, those that are over, too; the first started first."""
        return self.saved.records

    def start(self, name: str, now: float, priority: int | None = None) -> TaskRecord:
        """Begin a task."""
        if name not in self._tasks:
            raise self._no_such(name)
        if any(r.name == name and r.state not in OVER for r in self.records):
            raise UsageError(
                f"task '{name}' runs already; `poise task cancel {name}` ends it"
            )
        at = self._wall(now)
        record = TaskRecord(
            name=name,
            priority=self._tasks[name].priority if priority is None else priority,
            order=self._next(),
            began=at,
            since=at,
            progress=self._steps[name].begin(),
        )
        over = [r for r in self.records if r.state in OVER]
        for old in over[: max(0, len(over) - MOST_OVER + 1)]:
            self.records.remove(old)
        self.records.append(record)
        self._say(f"task '{name}' starts, with priority {record.priority}")
        return record

    def pause(self, name: str, now: float) -> None:
        """Pause a task until it is resumed; UsageError when it does not run."""
        record = self.find(name)
        if record.state != "paused":
            self._stop_clocks(record, now)
            self._enter(record, "paused", now, "on request")

    def resume(self, name: str, now: float) -> None:
        """Let a paused task go on; UsageError when it is not paused."""
        record = self.find(name)
        if record.state != "paused":
            raise UsageError(f"task '{name}' is {record.state}, not paused")
        self._enter(record, "waiting", now, "it is resumed")

    def cancel(self, name: str, now: float) -> None:
        """End a task; UsageError when it does not run."""
        record = self.find(name)
        self._stop_clocks(record, now)
        self._enter(record, "cancelled", now, "on request")

    def find(self, name: str) -> TaskRecord:
        """Return a task that is not over; UsageError when there is none."""
        for record in self.records:
            if record.name == name and record.state not in OVER:
                return record
        if name not in self._tasks:
            raise self._no_such(name)
        raise UsageError(f"task '{name}' does not run; `poise task start {name}`")

    def tries(self, record: TaskRecord) -> tuple[Attempt, ...]:
        """Return the actions of a task that are due now."""
        return self._steps[record.name].tries(record.progress)

    def going(self) -> list[TaskRecord]:
        """Return the tasks that may run now, the most important first."""
        return [r for r in self._by_rank() if r.state == "going"]

    def due(self) -> list[Attempt]:
        """Return the actions that should work now, of the most important task first."""
        return [attempt for record in self.going() for attempt in self.tries(record)]

    def arbitrate(self, now: float) -> None:
        """Decide which tasks may run now: the others wait, and say for what.

        A task waits while another of higher priority, or of the same that is at work,
        uses what only one may use; or while `block` says so.
        """
        granted: list[Attempt] = []
        for record in self._by_rank():
            mine = self.tries(record)
            why = self._blocked.get(record.name) or self._clash(record, granted, mine)
            if why:
                self._stop_clocks(record, now)
                self._enter(record, "waiting", now, why)
            else:
                self._enter(record, "going", now, "")
                granted += mine

    def announce(self) -> None:
        """Say which tasks go on, and which wait for what, where that has changed."""
        announced = self._announced
        self._announced = {r.order: (r.state, r.why) for r in self.records}
        for record in self.records:
            now = record.state, record.why
            before = announced.get(record.order, ("going", ""))
            if now != before and record.state in {"going", "waiting"}:
                what = "goes on" if record.state == "going" else "waits"
                self._say_of(record, what)

    def block(self, name: str, why: str) -> None:
        """Let a task wait, for a reason, until `unblock`."""
        self._blocked[name] = why

    def unblock(self) -> None:
        """Let all that were blocked be looked at again."""
        self._blocked.clear()

    def began(self, number: int, now: float) -> None:
        """Note that an action's functions work."""
        for _, attempt in self._all_tries():
            if attempt.number == number and not attempt.is_at_work:
                attempt.progress.since = now
                how = "goes on" if attempt.progress.spent else "begins"
                self._say(f"{attempt} {how}")

    def end(self, number: int, now: float, why: str, *, done: bool) -> None:
        """Note that an action has ended, and begin what comes next."""
        for record, attempt in list(self._all_tries()):
            if attempt.number == number:
                self._end(attempt, why, done=done)
                self._settle(record, now)

    def end_due(self, now: float, holds: Callable[[Until], bool]) -> None:
        """End actions whose time is over, and what conditions end."""
        for record in self.going():
            conditions = self._steps[record.name].conditions(record.progress)
            for until, progress in reversed(list(conditions)):  # the innermost first
                if holds(until):
                    self._end_by(record, until, progress)
            for attempt in self.tries(record):
                limit, worked = attempt.action.limit, self.worked(attempt, now)
                if limit is not None and worked >= limit:
                    why = f"its limit of {limit:g} s is over"
                    self._end(attempt, why, done=False)
            self._settle(record, now)

    def worked(self, attempt: Attempt, now: float) -> float:
        """Return for how long an action's functions have worked [s]."""
        since = attempt.progress.since
        return attempt.progress.spent + (0.0 if since is None else now - since)

    def functions_of(self, records: Iterable[TaskRecord]) -> set[str]:
        """Return the functions that tasks use while the actions work that are next."""
        return {
            function
            for record in records
            for attempt in self.tries(record)
            for function in attempt.action.functions
        }

    def next_actions(self) -> list[tuple[Attempt, float]]:
        """Return the actions that may come next, with their probabilities."""
        return [pair for record in self._by_rank() for pair in self._next_of(record)]

    def reports(
        self,
        upcoming: Collection[tuple[Attempt, float]],
        serving: Callable[[Attempt], tuple[str, ...]],
        now: float,
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
                        name=attempt.name,
                        functions=attempt.action.functions,
                        architectures=serving(attempt),
                        worked=self.worked(attempt, now),
                        is_at_work=attempt.is_at_work,
                    )
                    for attempt in self.tries(record)
                ),
                next=tuple(  # of one that waits, its own actions come next
                    attempt.name
                    for attempt, _ in upcoming
                    if attempt.task == record.name and record.state == "going"
                ),
            )
            for record in list(self.records)
        )

    def pop_ended(self) -> list[ActionEnded]:
        """Return the actions that have ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def _no_such(self, name: str) -> UsageError:
        names = ", ".join(self._tasks) or "none"
        what = f"robot '{self._robot.name}' has no task '{name}'"
        return UsageError(
            f"{what}{did_you_mean(name, self._tasks)}; its tasks: {names}"
        )

    def _next_of(self, record: TaskRecord) -> Iterable[tuple[Attempt, float]]:
        if record.state != "going":  # it goes on where it was
            return [(attempt, 1.0) for attempt in self.tries(record)]
        return self._steps[record.name].next_actions(record.progress)

    def _by_rank(self) -> list[TaskRecord]:
        """Return what is not over or paused, by priority, then what is at work."""
        records = [r for r in self.records if r.state not in _HALTED]
        if len(records) > 1:  # whether one is at work takes a walk through its steps
            records.sort(key=lambda r: (-r.priority, not self._is_at_work(r), r.order))
        return records

    def _is_at_work(self, record: TaskRecord) -> bool:
        return any(attempt.is_at_work for attempt in self.tries(record))

    def _clash(
        self, record: TaskRecord, granted: Iterable[Attempt], mine: Iterable[Attempt]
    ) -> str:
        """Return what a task cannot share with those before it; empty: nothing."""
        tries = {f"{each.task}.{each.name}": each for each in (*granted, *mine)}
        renamed = [replace(each.action, name=name) for name, each in tries.items()]
        for clash in clashes(self._robot, renamed):
            users = {
                each.task
                for name, each in tries.items()
                if any(f"'{name}'" in user for user in clash.users)
            }
            others = users - {record.name}
            # that of a task with itself is for `poise check`
            if others and record.name in users:
                use = "uses" if len(others) == 1 else "use"
                who = named("task", sorted(others))
                return f"{who} {use} the {clash.kind} '{clash.name}'"
        return ""

    def _stop_clocks(self, record: TaskRecord, now: float) -> None:
        """Stop the clocks of a task's actions: their functions do not work for it."""
        for attempt in self.tries(record):
            attempt.progress.spent = self.worked(attempt, now)
            attempt.progress.since = None

    def _end_by(self, record: TaskRecord, until: Until, progress: Progress) -> None:
        for attempt in self.tries(record):
            if attempt.progress is progress:
                self._end(attempt, f"{until.when} holds", done=True)
                return
        progress.state = "done"
        progress.inside = []
        self._say(f"task '{record.name}': a repetition ends: {until.when} holds")

    def _end(self, attempt: Attempt, why: str, *, done: bool) -> None:
        progress = attempt.progress
        progress.state = "done" if done else "ended"
        progress.why = "" if done else f"action '{attempt.name}' failed: {why}"
        how = "is done" if done else "has failed"
        self._say(f"{attempt} {how}: {why}")
        worked = progress.since is not None
        self._ended.append(ActionEnded(attempt.action, done, worked))

    def _settle(self, record: TaskRecord, now: float) -> None:
        steps = self._steps[record.name]
        state = steps.settle(record.progress)
        if state == "done":
            self._enter(record, "done", now, "")
        elif state == "failed":
            self._enter(record, "failed", now, record.progress.why)

    def _enter(
        self, record: TaskRecord, state: TaskState, now: float, why: str
    ) -> None:
        if (record.state, record.why) == (state, why):
            return
        is_new = record.state != state
        record.state, record.why = state, why
        if is_new:
            record.since = self._wall(now)
        if state not in {"going", "waiting"}:  # `announce` says these
            self._say_of(record, _SAYINGS[state])

    def _say_of(self, record: TaskRecord, what: str) -> None:
        why = f": {record.why}" if record.why else ""
        self._say(f"task '{record.name}' {what}{why}")

    def _all_tries(self) -> Iterator[tuple[TaskRecord, Attempt]]:
        for record in self.records:
            if record.state not in OVER:
                for attempt in self.tries(record):
                    yield record, attempt

    def _next(self) -> int:
        self.saved.number += 1
        return self.saved.number
