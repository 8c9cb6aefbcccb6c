"""The steps of a task: actions, and steps one after another, at once or in turn.

In the file a step is a mapping; its first key says which kind it is: `name` of an
action, `task` of another task's steps, `sequence`, `parallel`, `choice` or `repeat`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal, TypeAlias

from msgspec import Struct

from poise.model.file_keys import END, Name, Seconds, Share, says, written
from poise.model.policy import Subject
from poise.model.software import ConnectorEnd

KIND = "kind"
"""The field that tells the records of steps apart where they are encoded."""


class UntilKeys(Struct):
    """A condition over the values of one subject."""

    when: Annotated[str, says("The condition, over the subject's values.")]
    computer: Annotated[str | None, says("The computer that it is about.")] = None
    link: Annotated[str | None, says("The link, as in main-vision.")] = None
    component: Annotated[str | None, says("The component.")] = None
    container: Annotated[str | None, says("The container.")] = None
    timer: Annotated[str | None, says("The timer, as in localiser.update.")] = None
    chain: Annotated[str | None, says("The chain.")] = None


class Until(Struct, frozen=True, kw_only=True):
    """A condition over the values of one subject, as in policies."""

    when: str
    subject: Subject = "robot"
    name: str = ""  # of the subject; empty for the robot


def _until(value: str | Mapping[str, str]) -> Mapping[str, str]:
    if isinstance(value, str):
        return {"when": value}
    subjects = [key for key in value if key != "when"]
    if len(subjects) > 1:
        both = " and ".join(f"'{subject}'" for subject in subjects)
        raise ValueError(f"a condition is about one subject, not about {both}")
    named = {"subject": subjects[0], "name": value[subjects[0]]} if subjects else {}
    return {"when": value["when"], **named}


_UNTIL = written(str | UntilKeys, _until)


class Action(Struct, frozen=True, kw_only=True, tag="name", tag_field=KIND):
    """Uses functions until it is done.

    What comes first ends it: its component says so, the condition holds (both: done),
    or the time limit is over (failed). Without all of these it goes on until the task
    is cancelled.
    """

    name: Annotated[Name, says("What the action is called; unique in its task.")]
    functions: Annotated[tuple[Name, ...], says("The functions that it uses.")]
    ends: Annotated[
        ConnectorEnd | None,
        END,
        says(
            "The component.port that publishes a bool when it ends: true for done, "
            "false for failed."
        ),
    ] = None
    until: Annotated[
        Until | None,
        _UNTIL,
        says("The condition with which it is done: {chain: sight, when: age < 1 s}."),
    ] = None
    limit: Annotated[
        Seconds | None, says("It has failed after this time: 30 s.", gt=0)
    ] = None
    on_failure: Annotated[
        Literal["give up"] | Retry | Step,
        says(
            "What is done when it fails: give up the task, {retry: 2}, or another step "
            "instead.",
            key="on failure",
        ),
    ] = "give up"


class Retry(Struct, frozen=True, kw_only=True, tag="retry", tag_field=KIND):
    """An action that failed is begun again."""

    times: Annotated[int, says("How often it is begun again.", key="retry", ge=1)]
    then: Annotated[
        Literal["give up"] | Step,
        says("What is done when it still fails: give up the task, or another step."),
    ] = "give up"


class Subtask(Struct, frozen=True, kw_only=True, tag="task", tag_field=KIND):
    """The steps of another task."""

    task: Annotated[Name, says("The task whose steps are done here.")]


class Sequence(Struct, frozen=True, kw_only=True, tag="sequence", tag_field=KIND):
    """Steps one after another."""

    steps: Annotated[
        tuple[Step, ...], says("Steps one after another.", key="sequence", min_length=1)
    ]


class Parallel(Struct, frozen=True, kw_only=True, tag="parallel", tag_field=KIND):
    """Steps at once; it is done when all of them are."""

    steps: Annotated[
        tuple[Step, ...], says("Steps at once.", key="parallel", min_length=2)
    ]


class Choice(Struct, frozen=True, kw_only=True, tag="choice", tag_field=KIND):
    """One of several steps."""

    steps: Annotated[
        tuple[Step, ...],
        says("Steps of which one is done.", key="choice", min_length=2),
    ]


class Repeat(Struct, frozen=True, kw_only=True, tag="repeat", tag_field=KIND):
    """Steps one after another, again and again.

    Without `times` and `until`, until the task is cancelled.
    """

    steps: Annotated[
        tuple[Step, ...],
        says("Steps one after another, again.", key="repeat", min_length=1),
    ]
    times: Annotated[
        int | None, says("How often at most; without it, without end.", ge=1)
    ] = None
    until: Annotated[
        Until | None, _UNTIL, says("The condition with which it is done.")
    ] = None


Step: TypeAlias = Action | Subtask | Sequence | Parallel | Choice | Repeat


class Task(Struct, frozen=True, kw_only=True):
    """What the robot is asked to do: steps one after another."""

    name: str
    actions: Annotated[
        tuple[Step, ...], says("Its steps, one after another.", min_length=1)
    ]
    needs: Annotated[
        tuple[Name, ...],
        says(
            "The functions without which it stops, of those that its actions use; "
            "without the others it goes on degraded."
        ),
    ] = ()
    priority: Annotated[
        int,
        says(
            "Of tasks that need the same device or the same room, the one with the "
            "higher priority runs. Default: 0."
        ),
    ] = 0


StepPath = tuple[str | int, ...]
"""The keys and indices in the file that lead from a task to one of its steps."""


def walk(task: Task) -> Iterator[tuple[StepPath, Step]]:
    """Yield every step of a task with its path, outer ones first."""
    yield from _walk_all(task.actions, ("actions",))


def _walk_all(
    steps: tuple[Step, ...], path: StepPath
) -> Iterator[tuple[StepPath, Step]]:
    for index, step in enumerate(steps):
        yield from _walk(step, (*path, index))


def _walk(step: Step, path: StepPath) -> Iterator[tuple[StepPath, Step]]:
    yield path, step
    if isinstance(step, Action):
        inside: StepPath = (*path, "on failure")
        instead = step.on_failure
        if isinstance(instead, Retry):
            instead, inside = instead.then, (*inside, "then")
        if instead != "give up":
            yield from _walk(instead, inside)
    elif not isinstance(step, Subtask):
        yield from _walk_all(step.steps, (*path, kind_of(step)))


def kind_of(step: Step) -> str:
    """Return the key that names a step's kind, such as ``parallel``."""
    return str(type(step).__struct_config__.tag)


def actions_of(tasks: Mapping[str, Task], name: str) -> Iterator[Action]:
    """Yield every action of a task, as `steps_of` does."""
    return (step for step in steps_of(tasks, name) if isinstance(step, Action))


def steps_of(tasks: Mapping[str, Task], name: str) -> Iterator[Step]:
    """Yield every step of a task, with those of the tasks that it names, if known."""
    reached = [name]
    for task in reached:  # grows meanwhile
        for _, step in walk(tasks[task]) if task in tasks else ():
            yield step
            if isinstance(step, Subtask) and step.task not in reached:
                reached.append(step.task)


class Prefetch(Struct, frozen=True, kw_only=True):
    """What the next actions need is prepared: forked, imported, configured, inactive.

    The other half of the memory is for what grows, and for moves. Half of the CPU is
    enough to be ready soon; on emulated computers it comes from the same quota as that
    of the actions that run.
    """

    memory: Annotated[
        Share,
        says("Prepared components use at most this share of the memory left.", le=1),
    ] = 0.5
    cpu: Annotated[
        Share, says("Preparing uses at most this share of the CPU left.", gt=0, le=1)
    ] = 0.5
    off: bool = False


def _read(value: Literal["off"] | Mapping[str, float]) -> Mapping[str, object]:
    return {"off": True} if isinstance(value, str) else value


PREFETCH = written(Literal["off"] | Prefetch, _read)
"""How it is written: the two shares, or `off`."""
