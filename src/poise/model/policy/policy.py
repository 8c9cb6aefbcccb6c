"""The record of a policy, as the robot file and Poise's own file write it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias

from msgspec import Struct

from poise.model.file_keys import Name, Reference, Seconds, says, written
from poise.model.policy.values import SUBJECTS, Subject

Do: TypeAlias = Literal[
    "replan",
    "fail over",
    "move",
    "replace",
    "restart",
    "restart elsewhere",
    "put aside",
    "notify",
]

ACTIONS: Mapping[Do, tuple[Subject, ...]] = {
    "replan": tuple(SUBJECTS),
    "fail over": ("computer",),
    "move": ("component", "timer"),
    "replace": ("component", "container", "timer"),
    "restart": ("component", "container"),
    "restart elsewhere": ("container",),
    "put aside": ("component", "container", "timer", "computer"),
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
        Subject | None,
        says("What it looks at.", key="for each"),
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
        bool,
        says("Whether a move breaks limits, and a replacement drops the state."),
    ] = False
    call: Annotated[
        Reference | None,
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
