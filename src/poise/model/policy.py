"""The record of a policy, as the robot file and Poise's own file write it.

These are the names in conditions; the reference of the documentation site lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from msgspec import Struct

from poise.decoding import convert
from poise.errors import FileProblem, RobotError
from poise.model.file_keys import (
    Bandwidth,
    Bytes,
    Cores,
    FunctionReference,
    Name,
    Rate,
    Seconds,
    Share,
    says,
    written,
)
from poise.model.yaml_tree import parse
from poise.model.yaml_validation import validate

Subject: TypeAlias = Literal[
    "computer", "link", "component", "container", "timer", "chain", "robot"
]
ComponentState: TypeAlias = Literal[
    "unconfigured", "inactive", "active", "finalized", "failed", "unresponsive", "gone"
]
ContainerState: TypeAlias = Literal[
    "starting", "running", "unresponsive", "restarting", "stopped"
]
_COMPUTER = says("The computer on which it runs.")


class Values(Struct, frozen=True, kw_only=True):
    """The values of a subject, as conditions name them."""

    name: Annotated[str, says("Its name.")]


class ComputerValues(Values, frozen=True, kw_only=True):
    """A computer over the last half second."""

    lost: Annotated[bool, says("Whether it is out of reach.")] = False
    capacity: Annotated[Cores, says("The CPU that it has.")] = 0.0
    used: Annotated[Cores, says("CPU use of all programs.")] = 0.0
    background: Annotated[Cores, says("CPU use of programs that are not Poise's.")] = (
        0.0
    )
    full: Annotated[bool, says("Whether at least 95% of its CPU is used.")] = False
    starved: Annotated[
        Share, says("The largest share of jobs that a component there did not do.")
    ] = 0.0
    late: Annotated[int, says("Timers there that do not keep their rate.")] = 0
    drifted: Annotated[
        int, says("Components there whose demand has changed since they were placed.")
    ] = 0
    short: Annotated[
        Cores, says("What its components need and it does not have, reserves kept.")
    ] = 0.0
    culprit: Annotated[
        str, says("The largest use there that was not expected, in words.")
    ] = ""
    memory: Annotated[Bytes, says("Memory use of the robot's programs.")] = 0.0
    components: Annotated[int, says("Components that are placed there.")] = 0


class LinkValues(Values, frozen=True, kw_only=True):
    """A link between two computers, in both directions together."""

    name: Annotated[str, says("Its computers, as in main-vision.")]
    bandwidth: Annotated[Bandwidth, says("Each way, by the robot file.")] = 0.0
    traffic: Annotated[Bandwidth, says("What connectors carry over it now.")] = 0.0
    trip: Annotated[Seconds, says("The quickest of the last round trips.")] = 0.0
    latency: Annotated[Seconds, says("One way, by the robot file.")] = 0.0
    delay: Annotated[
        Seconds, says("One way, in the median of the last heartbeats.")
    ] = 0.0
    loss: Annotated[Share, says("Heartbeats of the last 5 s that did not come.")] = 0.0
    cut: Annotated[
        bool, says("Whether computers that the manager reaches do not hear each other.")
    ] = False


class ComponentValues(Values, frozen=True, kw_only=True):
    """A component and its present demand."""

    computer: Annotated[str, _COMPUTER]
    architecture: Annotated[str, says("Its architecture.")]
    priority: Annotated[int, says("Its architecture's priority.")] = 0
    state: Annotated[ComponentState, says("`gone`: its computer does not report it.")]
    cpu: Annotated[Cores, says("Its estimated demand.")] = 0.0
    expected: Annotated[Cores, says("Its demand by the robot file or profile.")] = 0.0
    starved: Annotated[Share, says("The share of its jobs that were not done.")] = 0.0
    hung: Annotated[
        Seconds, says("For how long a handler has run, or a due timer could not.")
    ] = 0.0
    long_job: Annotated[
        Seconds, says("For how long a job has computed, far longer than any before it.")
    ] = 0.0
    errors: Annotated[int, says("What its timers and handlers raised so far.")] = 0
    memory: Annotated[Bytes, says("Memory use of its container.")] = 0.0


class ContainerValues(Values, frozen=True, kw_only=True):
    """A container: the process of an architecture's components on a computer."""

    computer: Annotated[str, _COMPUTER]
    state: Annotated[ContainerState, says("As its agent sees it.")]
    reason: Annotated[str, says("Why it does not respond or cannot be started.")] = ""
    components: Annotated[str, says("The components in it.")] = ""
    restarts: Annotated[int, says("Restarts since the agent started.")] = 0
    restarts_lately: Annotated[int, says("Restarts within the last minute.")] = 0
    cpu: Annotated[Cores, says("CPU use.")] = 0.0
    memory: Annotated[Bytes, says("Memory use.")] = 0.0
    expected: Annotated[
        Bytes, says("The memory demand of its components by the robot file or profile.")
    ] = 0.0
    growth: Annotated[
        Bytes, says("By how much its memory grows in each second; 0: not steadily.")
    ] = 0.0
    limit: Annotated[
        Bytes, says("While it grows: the limit of its computer's memory.")
    ] = 0.0
    full_in: Annotated[
        Seconds, says("While it grows: the time until the limit is reached.")
    ] = 0.0


class TimerValues(Values, frozen=True, kw_only=True):
    """A timer with a deadline, over the last second or two periods."""

    name: Annotated[str, says("Component and timer, as in localiser.update.")]
    timer: Annotated[str, says("The timer's own name.")]
    component: Annotated[str, says("The component that has it.")]
    computer: Annotated[str, _COMPUTER]
    released: Annotated[int, says("How often it was due.")] = 0
    missed: Annotated[int, says("How many of these missed the deadline.")] = 0
    share: Annotated[Share, says("The same as a share.")] = 0.0
    over: Annotated[Seconds, says("The time over which this was counted.")] = 0.0
    deadline: Annotated[Seconds, says("How long after it was due it must end.")] = 0.0
    takes: Annotated[Seconds, says("How long its runs take, 99th percentile.")] = 0.0
    late: Annotated[
        bool, says("Whether it missed two deadlines and 20% of all, or every one.")
    ] = False


class ChainValues(Values, frozen=True, kw_only=True):
    """A chain: how old its data was when it was used, over a second or two uses."""

    component: Annotated[str, says("The last one, which uses the data.")]
    computer: Annotated[str, says("Where the data takes longest on its way.")]
    age: Annotated[Seconds, says("The mean age of the data when it was used.")] = 0.0
    deadline: Annotated[Seconds, says("How old it may be.")] = 0.0
    used: Annotated[int, says("How often it was used.")] = 0
    missed: Annotated[int, says("How often it was older than it may be.")] = 0
    share: Annotated[Share, says("The same as a share.")] = 0.0
    over: Annotated[Seconds, says("The time over which this was counted.")] = 0.0
    late: Annotated[
        bool,
        says("Whether it was too old twice and at 20% of all uses, or at every one."),
    ] = False
    steps: Annotated[str, says("How long data takes to each next component.")] = ""


class RobotValues(Values, frozen=True, kw_only=True):
    """The whole robot."""

    lost: Annotated[int, says("Computers that are out of reach.")] = 0
    late: Annotated[int, says("Timers that do not keep their rate.")] = 0
    used: Annotated[Cores, says("CPU use of all its computers.")] = 0.0
    calls: Annotated[Rate, says("Calls and messages over all connectors.")] = 0.0


SUBJECTS: Mapping[Subject, type[Values]] = {
    "computer": ComputerValues,
    "link": LinkValues,
    "component": ComponentValues,
    "container": ContainerValues,
    "timer": TimerValues,
    "chain": ChainValues,
    "robot": RobotValues,
}


Do: TypeAlias = Literal[
    "replan",
    "fail over",
    "move",
    "replace",
    "restart",
    "restart elsewhere",
    "suspend",
    "notify",
]

ACTIONS: Mapping[Do, tuple[Subject, ...]] = {
    "replan": tuple(SUBJECTS),
    "fail over": ("computer",),
    "move": ("component", "timer"),
    "replace": ("component", "container", "timer"),
    "restart": ("component", "container"),
    "restart elsewhere": ("container",),
    "suspend": ("component", "container", "timer", "computer"),
    "notify": tuple(SUBJECTS),
}
"""What may be done -> the subjects it can be done about."""


class Policy(Struct, frozen=True, kw_only=True):
    """What is done when a condition holds.

    A key that is None is not written: a policy of the robot file changes the shipped
    one of its name by the keys that it has.
    """

    name: str
    for_each: Annotated[
        Subject | None, says("The kind of thing that it is about.", key="for each")
    ] = None
    when: Annotated[
        str | None,
        says("The condition, over the subject's values: used > 90% and starved > 10%."),
    ] = None
    lasts: Annotated[
        Seconds | None, says("How long it must hold: 0.5 s, the default.")
    ] = None
    do: Annotated[Do | None, says("What is done.")] = None
    cool_down: Annotated[
        Seconds | None,
        says("How long until it may be done again: 3 s, the default.", key="cool down"),
    ] = None
    say: Annotated[
        str | None,
        says("A sentence for people, in which {used} stands for that value."),
    ] = None
    to: Annotated[Name | None, says("For move: the computer.")] = None
    by: Annotated[
        Name | None,
        says("For replace: the architecture; without it, the best alternative."),
    ] = None
    force: Annotated[
        bool, says("Whether a move breaks limits, and a replacement drops the state.")
    ] = False
    call: Annotated[
        FunctionReference | None,
        says(
            "package.module:function that returns what is to be done, instead of a "
            "condition."
        ),
    ] = None
    off: bool = False


LASTS = 0.5
"""A condition must hold for so long, unless its policy says otherwise [s]."""
COOL_DOWN = 3.0
"""An action is not repeated for so long, unless its policy says otherwise [s]."""


def _entries(entries: Mapping[str, object]) -> list[dict[str, object]]:
    return [
        {"name": name, **(entry if isinstance(entry, dict) else {"off": True})}
        for name, entry in entries.items()
    ]


POLICIES = written(dict[Name, Literal["off"] | Policy], _entries)
"""How the policies of a file are written: by name, `off` for one that is not used."""


class Seen(Struct, frozen=True, kw_only=True):
    """The values of all subjects, as policies see them.

    Parameters
    ----------
    at
        By the manager's clock, which never goes back [s].
    """

    at: float
    computers: tuple[ComputerValues, ...] = ()
    links: tuple[LinkValues, ...] = ()
    components: tuple[ComponentValues, ...] = ()
    containers: tuple[ContainerValues, ...] = ()
    timers: tuple[TimerValues, ...] = ()
    chains: tuple[ChainValues, ...] = ()
    robots: tuple[RobotValues, ...] = ()

    @classmethod
    def by(cls, read: Callable[[Subject], tuple[Values, ...]], at: float) -> Seen:
        """Return what `read` gives for each kind of subject."""
        values: dict[str, Any] = {f"{subject}s": read(subject) for subject in SUBJECTS}
        return cls(at=at, **values)

    def of(self, subject: Subject) -> tuple[Values, ...]:
        """Return the values of all subjects of a kind."""
        values: tuple[Values, ...] = getattr(self, f"{subject}s")
        return values


class PolicyAction(Struct, frozen=True, kw_only=True):
    """What a policy's own function wants done.

    Parameters
    ----------
    do
        The action, as in a robot file.
    about
        The name of the subject; for a timer ``component.timer``.
    why
        A sentence for people.
    to
        For `move`: the computer.
    by
        For `replace`: the architecture; empty: the best alternative.
    force
        As in a robot file.
    """

    do: Do
    about: str
    why: str
    to: str = ""
    by: str = ""
    force: bool = False


FILE = Path(__file__).with_name("shipped_policies.yaml")


@cache
def shipped() -> tuple[Policy, ...]:
    """Return the policies that Poise ships; a broken file is a bug of Poise."""
    problems: list[FileProblem] = []
    text = FILE.read_text(encoding="utf-8")
    root = parse(text, str(FILE), problems)
    if root is not None:
        kind = msgspec.inspect.type_info(Annotated[tuple[Policy, ...], POLICIES])
        valid = validate(root, kind, problems)
        if not problems:
            return convert(valid, tuple[Policy, ...])
    raise RobotError(problems=problems)


def policies_of(written: Iterable[Policy]) -> tuple[Policy, ...]:
    """Return a robot's policies, `off` ones too: shipped ones first, then its own.

    What a policy of the robot file does not give is that of the shipped one of its
    name, unless a function decides instead, or a default.
    """
    policies = {policy.name: policy for policy in shipped()}
    for own in written:
        new = Policy(name=own.name)
        before = new if own.call else policies.get(own.name, new)
        given = {k: v for k, v in msgspec.structs.asdict(own).items() if v is not None}
        policies[own.name] = msgspec.structs.replace(before, **given)
    return tuple(map(_whole, policies.values()))


def _whole(policy: Policy) -> Policy:
    return msgspec.structs.replace(
        policy,
        lasts=LASTS if policy.lasts is None else policy.lasts,
        cool_down=COOL_DOWN if policy.cool_down is None else policy.cool_down,
        say=policy.say or f"{policy.for_each} '{{name}}': {policy.when}",
    )
