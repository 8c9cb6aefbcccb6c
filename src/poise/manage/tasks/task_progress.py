"""How far a task and its steps are. Pure; times are given.

The records of progress mirror the steps: they can be sent to agents and read again by
the next manager.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from msgspec import Struct

from poise.manage.tasks.task_reports import TaskState
from poise.model.steps import (
    Action,
    Choice,
    Parallel,
    Repeat,
    Retry,
    Sequence,
    Step,
    Subtask,
    Task,
    Until,
)

Choose = Callable[[Choice, bool], int]
"""Returns the index of the step of a choice that is done; True: only looks ahead."""
Say = Callable[[str], object]


class Progress(Struct, kw_only=True, omit_defaults=True):
    """How far one step is."""

    state: str = "going"
    index: int = 0  # which step of a sequence or choice is inside
    rounds: int = 0  # how often a repetition has been done, or an action begun again
    number: int = 0  # tells the tries of actions of all tasks apart; 0: it is no action
    # when the action's functions began to work [s, `poise.clock.boot_time` of the
    # manager's computer]; None: they do not
    since: float | None = None
    spent: float = 0.0  # how long they worked before that [s]
    heard: int = 0  # the `ActionEnd.count` of its component as it began
    why: str = ""
    inside: list[Progress] = []


class Attempt(Struct, frozen=True, kw_only=True):
    """An action that is to run now."""

    task: str
    name: str  # as in phases: with the name of the other task whose step it is
    action: Action
    progress: Progress

    def __str__(self) -> str:
        return f"action '{self.name}' of task '{self.task}'"

    @property
    def number(self) -> int:
        """What tells it apart from all other tries."""
        return self.progress.number

    @property
    def is_at_work(self) -> bool:
        """Whether its functions work."""
        return self.progress.since is not None


class TaskRecord(Struct, kw_only=True):
    """One task since it was started."""

    name: str
    priority: int
    order: int  # later tasks have a higher one
    state: TaskState = "going"
    why: str = ""  # what it waits for, or why it ended so; else empty
    began: float
    since: float  # when its state began [s since 1970], for people; so is `began`
    progress: Progress


class Heard(Struct, kw_only=True):
    """Which requests of components were heard."""

    heard: dict[str, dict[int, int]] = {}  # as in `ComponentReports`


class Saved(Heard, kw_only=True):
    """All that the next manager needs to go on with the tasks."""

    records: list[TaskRecord] = []
    number: int = 0
    boot: str = ""  # the `poise.clock.boot_id` by whose clock times in `Progress` are


class ActionEnded(Struct, frozen=True):
    """An action that has ended."""

    action: Action
    done: bool
    worked: bool  # whether its functions worked then


class Steps:
    """Goes through the steps of a task."""

    def __init__(
        self,
        tasks: Mapping[str, Task],
        task: str,
        choose: Choose,
        number: Callable[[], int],
        say: Say,
    ) -> None:
        self._tasks = tasks
        self._whole = Subtask(task=task)
        self._choose = choose
        self._number = number
        self._say = say

    def begin(self) -> Progress:
        """Return the progress of a task that begins."""
        return self._begin(self._whole)

    def tries(self, whole: Progress) -> tuple[Attempt, ...]:
        """Return the actions that run now."""
        return tuple(self._attempts(self._whole, whole))

    def fit(self, whole: Progress) -> bool:
        """Return whether this is progress of these steps, and not of earlier ones."""
        try:
            self.tries(whole)
        except (AssertionError, IndexError, ValueError):
            return False
        return True

    def settle(self, whole: Progress) -> str:
        """Deal with all actions that have ended; return the state of the whole."""
        return self._settle(self._whole, whole)

    def conditions(self, whole: Progress) -> Iterator[tuple[Until, Progress]]:
        """Yield the conditions that end something now, and what they end."""
        for step, progress, _ in self._walk(self._whole, whole):
            is_at_work = isinstance(step, Repeat) or progress.since is not None
            if isinstance(step, Repeat | Action) and step.until and is_at_work:
                yield step.until, progress

    def next_actions(self, whole: Progress) -> list[tuple[Attempt, float]]:
        """Return the actions that may come next, with their probabilities.

        These are the first actions behind each one that runs, taken to be done. Which
        branch of a choice comes is what would be chosen now.
        """
        running = {attempt.name for attempt in self.tries(whole)}
        after = self._after(self._whole, whole)
        first = [attempt for attempt in after if attempt.name not in running]
        attempts = {attempt.name: (attempt, 1.0 / len(first)) for attempt in first}
        return list(attempts.values())

    def _of(self, step: Step) -> tuple[Step, ...]:
        """Return what a step does one after another; empty: something else."""
        match step:
            case Subtask(task=name):
                return self._tasks[name].actions
            case Sequence(steps=steps) | Repeat(steps=steps):
                return steps
        return ()

    def _begin(self, step: Step, *, is_ahead: bool = False) -> Progress:
        """Return the progress of a step that begins, or would; that has no numbers."""
        index = 0
        match step:
            case Action():
                return Progress(number=0 if is_ahead else self._number())
            case Parallel(steps=steps):
                first: Iterable[Step] = steps
            case Choice(steps=steps):
                index = self._choose(step, is_ahead)
                first = (steps[index],)
            case _:
                first = self._of(step)[:1]
        inside = [self._begin(inner, is_ahead=is_ahead) for inner in first]
        return Progress(index=index, inside=inside)

    def _pairs(self, step: Step, progress: Progress) -> Iterable[tuple[Step, Progress]]:
        """Return what is inside a step with its progress."""
        match step:
            case Action():
                if not progress.inside:
                    return ()
                inner = _instead(step)
            case Parallel(steps=steps):
                return zip(steps, progress.inside, strict=True)
            case Choice(steps=steps):
                inner = steps[progress.index]
            case _:
                inner = self._of(step)[progress.index]
        return ((inner, progress.inside[0]),)

    def _walk(
        self, step: Step, progress: Progress, prefix: str = ""
    ) -> list[tuple[Step, Progress, str]]:
        """Return the steps that go on, and what names of actions there begin with."""
        if progress.state != "going":
            return []
        nodes = [(step, progress, prefix)]
        if isinstance(step, Action):
            if not progress.inside:
                return nodes
            nodes = []
        prefix = self._prefix(step, prefix)
        for inner, inside in self._pairs(step, progress):
            nodes += self._walk(inner, inside, prefix)
        return nodes

    def _attempts(
        self, step: Step, progress: Progress, prefix: str = ""
    ) -> list[Attempt]:
        task = self._whole.task
        return [
            Attempt(task=task, name=inside + action.name, action=action, progress=each)
            for action, each, inside in self._walk(step, progress, prefix)
            if isinstance(action, Action)
        ]

    def _prefix(self, step: Step, prefix: str) -> str:
        """Return what the names of actions inside a step begin with."""
        if isinstance(step, Subtask) and step is not self._whole:
            return f"{step.task}."
        return prefix

    def _settle(self, step: Step, progress: Progress) -> str:
        if progress.state != "going":
            if progress.state == "ended" and isinstance(step, Action):
                self._settle_action(step, progress)
            return progress.state
        if isinstance(step, Action):
            if progress.inside:
                self._set_state(
                    progress, self._settle(_instead(step), progress.inside[0])
                )
            return progress.state
        states = [self._settle(*pair) for pair in self._pairs(step, progress)]
        if isinstance(step, Parallel | Choice):
            if "failed" in states:
                self._set_state(progress, "failed")
            elif "going" not in states:
                self._set_state(progress, "done")
        else:
            self._settle_sequence(step, progress, states[0])
        return progress.state

    def _settle_sequence(self, step: Step, progress: Progress, state: str) -> None:
        if state == "failed":
            self._set_state(progress, "failed")
        elif state == "done":
            steps = self._of(step)
            progress.index += 1
            if progress.index == len(steps):
                progress.index = 0
                progress.rounds += 1
                times = step.times if isinstance(step, Repeat) else 1
                if times is not None and progress.rounds >= times:
                    self._set_state(progress, "done")
                    return
            progress.inside = [self._begin(steps[progress.index])]

    def _settle_action(self, action: Action, progress: Progress) -> None:
        """Do what follows when an action has failed."""
        failed = action.on_failure
        progress.state = "going"
        progress.since, progress.spent = None, 0.0
        if isinstance(failed, Retry) and progress.rounds < failed.times:
            progress.rounds += 1
            progress.number = self._number()
            again = f"{progress.rounds} of {failed.times}"
            self._say(f"action '{action.name}' begins again ({again})")
        elif (instead := failed.then if isinstance(failed, Retry) else failed) != (
            "give up"
        ):
            progress.inside = [self._begin(instead)]
            progress.why = ""  # if that fails, too, its own reason counts
            self._say(f"action '{action.name}' failed: its alternative begins")
        else:
            progress.state = "failed"

    def _set_state(self, progress: Progress, state: str) -> None:
        if state == "going":
            return
        progress.state = state
        if state == "failed" and not progress.why:
            whys = [inner.why for inner in progress.inside if inner.state == "failed"]
            progress.why = "; ".join(filter(None, whys))
        progress.inside = []

    def _after(self, step: Step, progress: Progress, prefix: str = "") -> list[Attempt]:
        """Return the actions with which it may go on once those inside are done."""
        if progress.state != "going":
            return []
        prefix = self._prefix(step, prefix)
        attempts: list[Attempt] = []
        for inner, inside in self._pairs(step, progress):
            attempts += self._after(inner, inside, prefix)
        steps = self._of(step)
        if attempts or not steps:
            return attempts
        if progress.index + 1 < len(steps):
            return self._first(steps[progress.index + 1], prefix)
        goes_on = isinstance(step, Repeat) and (
            step.times is None or progress.rounds + 1 < step.times
        )
        return self._first(steps[0], prefix) if goes_on else []

    def _first(self, step: Step, prefix: str) -> list[Attempt]:
        return self._attempts(step, self._begin(step, is_ahead=True), prefix)


def _instead(action: Action) -> Step:
    """Return what is done instead of an action that failed."""
    failed = action.on_failure
    instead = failed.then if isinstance(failed, Retry) else failed
    assert not isinstance(instead, str)  # noqa: S101, it has progress
    return instead
