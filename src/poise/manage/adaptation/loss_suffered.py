"""When a change of the placement is carried out: once what it saves was lost. Pure.

A change that helps costs its moves, and nobody knows for how long it will help. So it
is made when the work that was lost because it had not been made equals its cost, as one
buys skis when the rents paid come to their price (Karlin, Manasse, Rudolph, Sleator
1988; for more than two states Borodin, Linial, Saks 1992, metrical task systems). Then
moves never cost more than the losses that led to them. docs/design/decisions.md says
how far from the best this is at worst.

What a change gains is a forecast. When it turns out to have gained less than half, as
where other programs follow the components, costs count twice from then on, and twice
again; each change that gains what it should takes half of such a step back. So what
gains only every other time comes to rest.
"""

from __future__ import annotations

from typing import NamedTuple

FORGET_AFTER = 600.0
"""After so long without a symptom [s] what was lost before counts no more."""
JUDGE_AFTER = 2.0
"""What a change has gained is looked at after this time [s]: loads are means."""
MOST_DOUBT = 1024.0
"""Costs never count more times."""


class LossSuffered:
    """What was lost because a better placement was not taken.

    Times are of one clock [s].

    Attributes
    ----------
    lost
        Since the last change [core-seconds].
    doubt
        How many times a cost counts, >= 1: twice more after each change in vain.
    """

    def __init__(self) -> None:
        self.lost = 0.0
        self.doubt = 1.0
        self._change: _Change | None = None
        self._gain = 0.0
        self._at: float | None = None
        self._begins = self._ended = float("-inf")

    def note(self, gain: float, since: float, now: float) -> None:
        """Take note of what the best change would gain now [cores].

        Parameters
        ----------
        since
            When it began that something is wrong [s].
        """
        if self._at is None:
            if now - self._ended > FORGET_AFTER:
                self.lost = 0.0
            self.lost += gain * (now - max(since, self._begins))
        else:
            self.lost += self._gain * (now - self._at)
        self._gain, self._at = gain, now

    def earned_at(self, cost: float, now: float) -> float:
        """Return when the loss will equal a cost [core-seconds], as things go."""
        if self.lost >= cost:
            return now
        return now + (cost - self.lost) / self._gain if self._gain > 0 else float("inf")

    def lasts(self, since: float, now: float) -> float:
        """Return for how long it has been wrong in this placement [s]."""
        return now - max(since, self._begins)

    def end(self, now: float) -> None:
        """Take note that nothing is wrong any more."""
        self.judge(0.0, now)
        if self._at is not None:
            self.lost += self._gain * (now - self._at)
            self._gain, self._at, self._begins, self._ended = 0.0, None, now, now

    def note_change(self, undone: float, gain: float, now: float) -> None:
        """Count from zero again, as the placement changes.

        Parameters
        ----------
        undone
            Work that is not done before [cores].
        gain
            By how much that should fall [cores]; 0: nothing moves, so there is nothing
            to be judged.
        """
        self.lost = self._gain = 0.0
        self._at, self._begins = None, now
        self._change = _Change(undone, gain, now) if gain > 0 else None

    def judge(self, undone: float, now: float) -> None:
        """See whether the last change has gained what it should."""
        change = self._change
        if change is None or now < change.at + JUDGE_AFTER:
            return
        is_in_vain = change.undone - undone < change.gain / 2
        factor = 2.0 if is_in_vain else 0.5**0.5
        self.doubt = min(max(1.0, factor * self.doubt), MOST_DOUBT)
        self._change = None


class _Change(NamedTuple):
    undone: float
    gain: float
    at: float
