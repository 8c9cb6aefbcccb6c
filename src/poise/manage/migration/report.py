"""How a move or a replacement went."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.manage.journal import Journal
from poise.wire.records.migration import StepTaken


class MigrationReport(Struct, frozen=True, tag=True, kw_only=True):
    """How a move went, or the replacement of a component's code or an architecture.

    Parameters
    ----------
    what
        The component or the architecture.
    by
        What was to replace it: ``package.module:Class`` or an architecture; empty: it
        was to move.
    before, after
        Component -> computer: where they ran, and where they, or others, were to run.
    committed
        Whether `after` holds now; else `before` does, as if nothing had been asked.
    reason
        Why not.
    cold
        Whether it was stopped and started, as command-line components are.
    downtime
        How long the components were paused, or a cold one was away [s].
    phases
        How long each phase took [s].
    steps
        What containers did, by container in the order of their answers.
    """

    what: str
    by: str = ""
    before: Mapping[str, str]
    after: Mapping[str, str]
    committed: bool = False
    reason: str = ""
    cold: bool = False
    downtime: float = 0.0
    phases: Mapping[str, float] = {}
    steps: tuple[StepTaken, ...] = ()

    @property
    def prepared(self) -> float:
        """How long it took before the pause [s]."""
        return self.phases.get("prepare", 0.0)

    @property
    def name(self) -> str:
        """What it is about, for people: ``component 'localiser'``."""
        kind = "architecture" if self.by and ":" not in self.by else "component"
        return f"{kind} '{self.what}'"

    def note_in(self, journal: Journal) -> None:
        """Journal what was done, or why it was not."""
        before, after = self.before.get(self.what), self.after.get(self.what)
        way = f"{self.name} from '{before}' to '{after}'"
        if self.by:
            way = f"{self.name} by '{self.by}'"
        if self.committed:
            how = " by a cold move" if self.cold else ""
            verb = "replaced" if self.by else "moved"
            text = f"{verb} {way}{how}; {self._times()}"
            journal.note("done", text, migration=self)
        else:
            text = f"did not {'replace' if self.by else 'move'} {way}: {self.reason}"
            journal.note("failed", text, migration=self)

    def _times(self) -> str:
        if self.cold:
            return f"downtime {self.downtime:.2f} s"
        phases = ", ".join(f"{n} {s * 1e3:.1f}" for n, s in self.phases.items())
        return f"downtime {self.downtime * 1e3:.1f} ms ({phases} ms)"
