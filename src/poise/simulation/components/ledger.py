"""What components really did, by a common clock: what the invariants look at."""

from __future__ import annotations

from typing import NamedTuple

LATE_HANDLER = 0.75
"""A handler that runs while its lease ends may go on this long beside a newer
incarnation, without any effect [s]: its container is killed then."""


class WorkingIncarnation(NamedTuple):
    """One life of a component in one process."""

    component: str
    epoch: int
    computer: str
    pid: int

    def __str__(self) -> str:
        return f"'{self.component}' ({self.epoch}) on '{self.computer}'"


class Ledger:
    """Who worked when, and which messages were processed.

    Attributes
    ----------
    violations
        What must never be, as (invariant, sentence) in the order in which it was seen.
    handled, processed
        How many handlers and messages there were.
    dropped
        How many messages made room for newer ones.
    calls, failed_calls
        How many calls were answered, and how many were not within their limits.
    """

    def __init__(self) -> None:
        self.violations: list[tuple[str, str]] = []
        self.handled = 0
        self.processed = 0
        self.dropped = self.calls = self.failed_calls = 0
        self._current: dict[str, tuple[WorkingIncarnation, float]] = {}
        self._past: set[WorkingIncarnation] = set()
        self._committed: dict[str, int] = {}
        self._sent: dict[str, int] = {}
        self._last: dict[str, int] = {}

    def begin(self, who: WorkingIncarnation, now: float) -> None:
        """Note that a handler begins."""
        self.handled += 1
        known = self._current.get(who.component)
        if known is not None and known[0] == who:
            return
        if who.epoch < self._committed.get(who.component, 0):
            self.violate(
                "committed-stays",
                f"{who} began a handler at {now:.3f} s, but a move to incarnation "
                f"{self._committed[who.component]} was committed",
            )
        if who in self._past and known is not None:
            self.violate(
                "nothing-active-twice",
                f"{who} began a handler at {now:.3f} s, but {known[0]} has worked "
                f"since {known[1]:.3f} s",
            )
            return
        if known is not None:
            self._past.add(known[0])
        self._current[who.component] = who, now

    def end(self, who: WorkingIncarnation, awake: float, now: float) -> None:
        """Note that a handler ended.

        Parameters
        ----------
        awake
            Since when its process runs without a pause [s].
        """
        current, since = self._current[who.component]
        if who in self._past and now - max(since, awake) > LATE_HANDLER:
            self.violate(
                "nothing-active-twice",
                f"a handler of {who} went on until {now:.3f} s, but {current} has "
                f"worked since {since:.3f} s",
            )

    def act(self, who: WorkingIncarnation, now: float) -> None:
        """Note that a handler publishes."""
        if who in self._past:
            current, since = self._current[who.component]
            self.violate(
                "nothing-active-twice",
                f"{who} published at {now:.3f} s, but {current} has worked since "
                f"{since:.3f} s",
            )

    def commit(self, component: str, epoch: int) -> None:
        """Note that a client was told that a move to an incarnation is committed."""
        self._committed[component] = epoch

    def number(self, connector: str) -> int:
        """Return the number of the next message of a connector."""
        self._sent[connector] = self._sent.get(connector, 0) + 1
        return self._sent[connector]

    def process(self, connector: str, number: int, who: WorkingIncarnation) -> None:
        """Note that a message is processed."""
        self.processed += 1
        last = self._last.get(connector, 0)
        if number <= last:
            self.violate(
                "each-message-once-in-order",
                f"{who} processed message {number} of '{connector}' after {last}",
            )
        self._last[connector] = number

    def note_call(self, *, is_answered: bool) -> None:
        """Note how a call ended."""
        if is_answered:
            self.calls += 1
        else:
            self.failed_calls += 1

    def violate(self, invariant: str, what: str) -> None:
        """Note what must never be; the run ends with this step."""
        self.violations.append((invariant, what))
