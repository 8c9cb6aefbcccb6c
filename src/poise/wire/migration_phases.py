"""The phases of a migration, and which may follow which, on both sides."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Literal

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
    """The state machine of one party to a migration; any thread may use it.

    Parameters
    ----------
    who
        Names the party in errors: ``migration of component 'localiser'``.
    """

    def __init__(self, role: Role, who: str) -> None:
        self._allowed = TRANSITIONS[role]
        self._who = who
        self._phase: Before = "start"
        self._since = time.monotonic()
        self._seconds: dict[str, float] = {}
        self._changing = threading.Lock()

    def enter(self, phase: Phase, since: float | None = None) -> None:
        """Go to a phase; harmless when it is there already.

        Parameters
        ----------
        since
            When it began, by the monotonic clock [s]; None: now.

        Raises
        ------
        RunError
            The phase may not follow the present one, which stays.
        """
        with self._changing:
            self._check(phase)
            self._count(since)
            self._phase = phase

    @contextmanager
    def taking(self, step: str, phase: Phase) -> Iterator[None]:
        """Take a step, and enter the phase that it leads to when it succeeds.

        Raises
        ------
        RunError
            The phase may not follow the present one, before or after the step.
        """
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
