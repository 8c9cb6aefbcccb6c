"""What a move, a replacement or a transition would change, and how it went."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from msgspec import Struct

from poise.manage.observe.estimates import PresentDemand
from poise.plan.result_records import Terms
from poise.wire.records.migration_records import StepTaken

if TYPE_CHECKING:
    from poise.manage.journal import Journal


class MigrationReport(Struct, frozen=True, tag=True, kw_only=True):
    """How a move went, or the replacement of a component's code or an architecture."""

    what: str  # the component or the architecture
    # what was to replace it: ``package.module:Class`` or an architecture; empty: it was
    # to move
    by: str = ""
    before: Mapping[str, str]
    after: Mapping[str, str]
    # whether `after` holds now; else `before` does, as if nothing had been asked
    committed: bool = False
    reason: str = ""  # why not
    cold: bool = False
    # whether it is a node of ROS 2 that begins anew: it has no `snapshot` and `restore`
    stateless: bool = False
    # how long the components were paused, or a cold one was away [s]
    downtime: float = 0.0
    phases: Mapping[str, float] = {}  # how long each phase took [s]
    steps: tuple[StepTaken, ...] = ()
    # connector over a cut or slow link -> why messages on it may have been dropped
    dropped: Mapping[str, str] = {}

    @property
    def prepared(self) -> float:
        """How long it took before the pause [s]."""
        return self.phases.get("prepare", 0.0)

    @property
    def name(self) -> str:
        """What it is about, for people: ``component 'localiser'``."""
        kind = "architecture" if self.by and ":" not in self.by else "component"
        return f"{kind} '{self.what}'"

    @property
    def way(self) -> str:
        """The same with where it goes, or what comes instead."""
        if self.by:
            return f"{self.name} by '{self.by}'"
        before, after = self.before.get(self.what), self.after.get(self.what)
        return f"{self.name} from '{before}' to '{after}'"

    def note_in(self, journal: Journal) -> None:
        """Journal what was done, or why it was not."""
        if self.committed:
            how = " by a cold move" if self.cold else ""
            verb = "replaced" if self.by else "moved"
            times = f"{self._times()}{self.without_state}"
            text = f"{verb} {self.way}{how}; {times}{self._losses()}"
            journal.note("done", text, migration=self)
        else:
            verb = "replace" if self.by else "move"
            text = f"did not {verb} {self.way}: {self.reason}"
            journal.note("failed", text, migration=self)

    @property
    def without_state(self) -> str:
        """Say that it begins anew, when it does."""
        if not self.stateless:
            return ""
        return "; it begins anew, for the node has no `snapshot` and `restore`"

    def _losses(self) -> str:
        return "".join(
            f"; messages under way over '{connector}' were dropped: {why}"
            for connector, why in self.dropped.items()
        )

    def _times(self) -> str:
        if self.cold:
            return f"downtime {self.downtime:.2f} s"
        phases = ", ".join(f"{n} {s * 1e3:.1f}" for n, s in self.phases.items())
        return f"downtime {self.downtime * 1e3:.1f} ms ({phases} ms)"


class TransitionStep(Struct, frozen=True):
    """One step of a transition."""

    component: str
    # computers; a start has no source, a stop no target, and a move has both
    source: str = ""
    # computers; a start has no source, a stop no target, and a move has both
    target: str = ""
    # why it is no direct live move: an intermediate or a cold one; else empty
    why: str = ""

    def inverse(self) -> TransitionStep:
        """Return the step that undoes it."""
        return TransitionStep(self.component, self.target, self.source)

    def __str__(self) -> str:
        way = f"move {self.component} from {self.source} to {self.target}"
        if not self.source:
            way = f"start {self.component} on {self.target}"
        elif not self.target:
            way = f"stop {self.component} on {self.source}"
        return f"{way} ({self.why})" if self.why else way


class TransitionReport(Struct, frozen=True, kw_only=True):
    """How a transition went."""

    steps: tuple[TransitionStep, ...]  # what was planned
    committed: bool  # whether the new placement holds; else the old one does again
    reason: str = ""  # why not; also when the roll back failed
    moves: tuple[MigrationReport, ...] = ()


class Proposal(Struct, frozen=True, kw_only=True):
    """Where components should run now.

    Parameters
    ----------
    shifted
        Component -> what it needs now, where that has shifted or is more than was
        counted with.
    now, then
        F of the placement that is, and of the one proposed, for the same demands.
    trouble
        Which limits the placement that is breaks; empty when it keeps all.
    steps
        From the one to the other; none when it is best to stay.
    proven
        Whether no placement is better.
    suspended
        The architectures that are suspended: not all fits.
    """

    shifted: Mapping[str, PresentDemand]
    now: Terms
    then: Terms
    placement: Mapping[str, str]
    trouble: str = ""
    steps: tuple[TransitionStep, ...] = ()
    proven: bool = False
    suspended: tuple[str, ...] = ()


class WhatIf(Struct, frozen=True, tag=True, kw_only=True):
    """What a move would change, for the demands that components have now.

    Parameters
    ----------
    now, then
        F before and after the move.
    breaks
        The limits that it would break: then it is refused, unless it is forced.
    trouble
        Which limits are broken as it is; empty: none.
    loads
        Computer -> the CPU that its components need, before and after [cores].
    usable
        Computer -> the CPU that there is for them beside other programs [cores].
    downtime
        For how long its last move paused the component [s]; None: it was not moved yet.
    cost
        Work that the move would cost [core-seconds].
    state
        Size of its snapshot, if that was ever taken [bytes].
    """

    component: str
    source: str
    target: str
    now: Terms
    then: Terms
    breaks: tuple[str, ...] = ()
    trouble: str = ""
    loads: Mapping[str, tuple[float, float]] = {}
    usable: Mapping[str, float] = {}
    downtime: float | None
    cost: float = 0.0
    state: int = 0
