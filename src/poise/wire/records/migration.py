"""What manager and containers tell each other while components move.

A *source* is the incarnation that a component leaves, a *target* the one that it goes
to. Why the steps come in this order, and what each is for: docs/design/moves.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from msgspec import Struct

from poise.wire.migration_phases import Phase, Role


class _Step(Struct, frozen=True):
    component: str
    epoch: int


class SourceStep(_Step, frozen=True):
    """A step of a source."""

    role: ClassVar[Role] = "source"


class TargetStep(_Step, frozen=True):
    """A step of a target."""

    role: ClassVar[Role] = "target"


class OfferState(SourceStep, frozen=True, tag="offer state"):
    """Source: serve the state to the targets of this migration."""

    phase: ClassVar[Phase] = "prepare"


class PreCopy(TargetStep, frozen=True, tag="pre-copy"):
    """Target: connect to the sources, and fetch a large state while they still work.

    From a source of the same component it takes state, buffered messages and timers;
    from other components what `adapt` (`ComponentSpec`) makes of their states.

    Parameters
    ----------
    sources
        The components that transfer their state, and their epochs.
    addresses
        Where their containers are reached.
    """

    phase: ClassVar[Phase] = "prepare"
    sources: Mapping[str, int]
    addresses: Mapping[str, str]


class RequestState(TargetStep, frozen=True, tag="request state"):
    """Target: ask the sources for everything; they answer when they send it."""

    phase: ClassVar[Phase] = "prepare"


class AwaitIdle(SourceStep, frozen=True, tag="await idle"):
    """Source: wait until it has just finished its work, at most for `limit` [s].

    A pause that begins then delays nobody. The step succeeds without it, too.
    """

    phase: ClassVar[Phase] = "prepare"
    limit: float


class Buffer(Struct, frozen=True, tag="buffer"):
    """Send a marker over these connectors, and buffer all messages after it."""

    phase: ClassVar[Phase] = "quiesce"
    connectors: tuple[str, ...]


class Pause(SourceStep, frozen=True, tag="pause"):
    """Source: finish the calls in progress, start no more, and send markers."""

    phase: ClassVar[Phase] = "quiesce"


class DrainChannels(_Step, frozen=True, tag="drain channels"):
    """Wait until the markers have arrived at a component over these connectors."""

    phase: ClassVar[Phase] = "quiesce"
    connectors: tuple[str, ...]


class DrainMailbox(SourceStep, frozen=True, tag="drain mailbox"):
    """Source, to which no message comes any more: handle all that wait."""

    phase: ClassVar[Phase] = "quiesce"


class SendState(SourceStep, frozen=True, tag="send state"):
    """Source, paused and drained: send the state to the targets that asked for it."""

    phase: ClassVar[Phase] = "transfer"


class RestoreState(TargetStep, frozen=True, tag="restore state"):
    """Target: restore the state as soon as the sources send it."""

    phase: ClassVar[Phase] = "transfer"


class Activate(TargetStep, frozen=True, tag="activate"):
    """Target, with its state restored: run `activate`, and stay paused."""

    phase: ClassVar[Phase] = "transfer"


class Redirect(SourceStep, frozen=True, tag="redirect"):
    """Source: send callers that wait for it to the target."""

    phase: ClassVar[Phase] = "commit"


class Resume(TargetStep, frozen=True, tag="resume"):
    """Target: begin to work."""

    phase: ClassVar[Phase] = "resume"


class RollBack(SourceStep, frozen=True, tag="roll back"):
    """Source: resume after a migration that failed."""

    phase: ClassVar[Phase] = "roll back"


class Release(Struct, frozen=True, tag="release"):
    """Send buffered messages, and all that follow, over the connectors with these keys.

    `phase` is ``resume`` or ``roll back``: the keys lead to the targets or the sources.
    """

    keys: tuple[str, ...]
    phase: Phase


ComponentStep = (
    OfferState
    | PreCopy
    | RequestState
    | AwaitIdle
    | Pause
    | DrainChannels
    | DrainMailbox
    | SendState
    | RestoreState
    | Activate
    | Redirect
    | Resume
    | RollBack
)
"""A step of one component."""
SenderStep = Buffer | Release
"""A step of connectors that begin in a container."""
MigrationStep = ComponentStep | SenderStep


def name_of_step(step: MigrationStep) -> str:
    """Return the name of a step, as people see it: ``drain channels``."""
    return str(step.__struct_config__.tag)


class MigrationSteps(Struct, frozen=True, tag=True):
    """Steps for one container, one after the other; the first that fails ends them.

    Parameters
    ----------
    number
        Tells these steps from all others.
    migration
        The migration that they belong to; its markers have the same number.
    limit
        They are answered within this time [s], but may still be taken afterwards.
    """

    number: int
    migration: int
    container: str
    steps: tuple[MigrationStep, ...]
    limit: float


class StepTaken(Struct, frozen=True):
    """A step that a container took, for the trace of a migration.

    Parameters
    ----------
    who
        Component and epoch (``localiser/3``), or the container of a sender.
    began, ended
        By the monotonic clock of the container's computer [s].
    """

    who: str
    step: str
    phase: Phase
    began: float
    ended: float


class StepsDone(Struct, frozen=True, tag=True):
    """All steps were taken."""

    number: int
    taken: tuple[StepTaken, ...] = ()


class StepsFailed(Struct, frozen=True, tag=True):
    """A step was not taken, and why; all is as before that step."""

    number: int
    reason: str
    taken: tuple[StepTaken, ...] = ()


StepsOutcome = StepsDone | StepsFailed
