"""What is known of a running robot at one moment, and what a function makes of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msgspec import Struct

from poise.model.policy.policy import Do
from poise.model.policy.values import (
    SUBJECTS,
    ChainValues,
    ComponentValues,
    ComputerValues,
    ContainerValues,
    LinkValues,
    RobotValues,
    Subject,
    TimerValues,
    Values,
)


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
        found: tuple[Values, ...] = getattr(self, f"{subject}s")
        return found


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
