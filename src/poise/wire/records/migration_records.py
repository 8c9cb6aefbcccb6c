"""What manager and containers tell each other while components move.

A component leaves its *source* for its *target*, by the steps of docs/design/moves.md.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Literal

from msgspec import Struct

from poise.errors import RunError

Phase = Literal["prepare", "quiesce", "transfer", "commit", "resume", "roll back"]
Role = Literal["manager", "source", "target"]
"""The manager, and the incarnations that a component leaves and goes to."""

Before = Phase | Literal["start"]

TRANSITIONS: Mapping[Role, Mapping[Before, frozenset[Phase]]] = {
    "manager": {
        "start": frozenset({"prepare"}),
        "prepare": frozenset({"quiesce", "roll back"}),
        "quiesce": frozenset({"transfer", "roll back"}),
        "transfer": frozenset({"commit", "roll back"}),
        "commit": frozenset({"resume"}),
    },
    "source": {
        # a container that was started again in the middle knows of no migration
        "start": frozenset({"prepare", "commit", "roll back"}),
        "prepare": frozenset({"quiesce", "roll back"}),
        "quiesce": frozenset({"transfer", "roll back"}),
        "transfer": frozenset({"commit", "roll back"}),
    },
    "target": {
        "start": frozenset({"prepare", "resume"}),
        "prepare": frozenset({"transfer"}),
        "transfer": frozenset({"resume"}),
    },
}
"""The phases that may follow a phase. A phase may always be entered again."""


class MigrationPhases:
    """The state machine of one party to a migration; any thread may use it."""

    def __init__(self, role: Role, who: str) -> None:
        self._allowed = TRANSITIONS[role]
        self._who = who
        self._phase: Before = "start"
        self._since = time.monotonic()
        self._seconds: dict[str, float] = {}
        self._changing = threading.Lock()

    def enter(self, phase: Phase, since: float | None = None) -> None:
        """Go to a phase since a moment [s]; RunError when it may not follow."""
        with self._changing:
            self._check(phase)
            self._count(since)
            self._phase = phase

    @contextmanager
    def taking(self, step: str, phase: Phase) -> Iterator[None]:
        """Take a step, and enter the phase that it leads to when it succeeds."""
        with self._changing:
            self._check(phase, step)
        yield
        self.enter(phase)

    def seconds(self) -> dict[str, float]:
        """Return how long each phase took until now, in order [s]."""
        with self._changing:
            self._count()
            return dict(self._seconds)

    def _check(self, phase: Phase, step: str = "") -> None:
        allowed = self._allowed.get(self._phase, frozenset())
        if phase != self._phase and phase not in allowed:
            leads = f"step '{step}' leads to phase" if step else "phase"
            choices = ", ".join(sorted(allowed)) or "no other"
            raise RunError(
                f"{self._who}: {leads} '{phase}', which may not follow "
                f"'{self._phase}' (only {choices})"
            )

    def _count(self, until: float | None = None) -> None:
        now = time.monotonic() if until is None else until
        if self._phase != "start":
            seconds = self._seconds.get(self._phase, 0.0)
            self._seconds[self._phase] = seconds + now - self._since
        self._since = now


StepName = Literal[
    "offer state",
    "pre-copy",
    "request state",
    "await idle",
    "buffer",
    "pause",
    "drain channels",
    "drain mailbox",
    "send state",
    "restore state",
    "activate",
    "redirect",
    "resume",
    "release to targets",
    "roll back",
    "release to sources",
    "halt",
]

STEPS: Mapping[StepName, tuple[Role | None, Phase]] = {
    # serve the state to the targets of this migration
    "offer state": ("source", "prepare"),
    # connect to the sources, and fetch a large state while they still work
    "pre-copy": ("target", "prepare"),
    # ask the sources for everything; they answer when they send it
    "request state": ("target", "prepare"),
    # wait until its target has requested everything, and until it has just finished its
    # work: a pause that begins then delays nobody; succeeds at its limit, too
    "await idle": ("source", "prepare"),
    # send a marker over connectors, and buffer all messages after it; where they are
    # lossy, send no marker, and buffer only what the subscriber would keep
    "buffer": (None, "quiesce"),
    # finish the calls in progress, start no more, and send markers but over lossy
    # connectors
    "pause": ("source", "quiesce"),
    # wait until the markers have arrived at a component over connectors; take no more
    # over lossy ones
    "drain channels": (None, "quiesce"),
    # handle all messages that wait; no more come
    "drain mailbox": ("source", "quiesce"),
    # paused and drained: send the state to the targets that asked for it
    "send state": ("source", "transfer"),
    # restore the state as soon as the sources send it
    "restore state": ("target", "transfer"),
    # run `activate`, and stay paused
    "activate": ("target", "transfer"),
    # send callers that wait for it to the target
    "redirect": ("source", "commit"),
    # begin to work
    "resume": ("target", "resume"),
    # send buffered messages, and all that follow, to the targets
    "release to targets": (None, "resume"),
    # resume after a migration that failed
    "roll back": ("source", "roll back"),
    # send buffered messages, and all that follow, to the sources again
    "release to sources": (None, "roll back"),
    # a new manager decides: take no more steps of the migration that it found
    "halt": (None, "prepare"),
}
"""All steps: which party takes each, and the phase that it leads to. Steps without a
party are taken by other components, or by connectors that begin in a container."""


class Step(Struct, frozen=True, omit_defaults=True):
    """A step of a migration."""

    name: StepName
    # The incarnation that takes it; empty for a step of connectors
    component: str = ""
    epoch: int = 0
    connectors: tuple[str, ...] = ()  # Their names, for `buffer` and `drain channels`
    keys: tuple[str, ...] = ()  # Those of connectors, for a release
    # For `pre-copy`: component -> epoch and address of the incarnations that transfer
    # their state. From a source of the same component a target takes state, buffered
    # messages and timers; from others what `adapt` (`ComponentSpec`) makes of their
    # states
    sources: Mapping[str, tuple[int, str]] = {}
    # Keys of connectors whose link is cut, for `buffer`, `pause` and `drain channels`,
    # and how many messages their subscribers keep
    lossy: Mapping[str, int] = {}
    limit: float = 0.0  # For `await idle` [s]

    @property
    def role(self) -> Role | None:
        """The party that takes it."""
        return STEPS[self.name][0]

    @property
    def phase(self) -> Phase:
        """The phase that it leads to."""
        return STEPS[self.name][1]


Targets = tuple[tuple[str, int], ...]
"""Component and epoch of all targets of a migration, which tell it from all others."""


class MigrationSteps(Struct, frozen=True, tag=True):
    """Steps for one container, one after the other; the first that fails ends them."""

    number: int  # Tells these steps from all others
    # The migration that they belong to; its markers have the same number
    migration: int
    container: str
    steps: tuple[Step, ...]
    # They are answered within this time [s], but may still be taken afterwards
    limit: float
    targets: Targets = ()


class StepTaken(Struct, frozen=True):
    """A step that a container took, for the trace of a migration."""

    who: str  # Component and epoch (``localiser/3``), or the container of a sender
    step: StepName
    phase: Phase
    # By the monotonic clock of the container's computer [s]
    began: float
    ended: float


class StepsDone(Struct, frozen=True, tag=True):
    """All steps were taken."""

    number: int
    taken: tuple[StepTaken, ...] = ()
    # Answers `halt`: of which migration the container began steps last, since the
    # latest deployment that a manager made, and whether one of them follows the commit
    targets: Targets = ()
    is_committed: bool = False


class StepsFailed(Struct, frozen=True, tag=True):
    """A step was not taken, and why; all is as before that step."""

    number: int
    reason: str
    taken: tuple[StepTaken, ...] = ()


StepsOutcome = StepsDone | StepsFailed
