"""When to change the placement: when the work lost without it equals its cost.

This is ski rental (Karlin, Manasse, Rudolph, Sleator 1988): docs/design/decisions.md
says how far from the best it is at worst. After a change that gained less than half of
its forecast, costs count twice; one that gained it takes half of such a step back.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from math import inf
from typing import NamedTuple

from poise.manage.migration.migration_report import TransitionStep

Amounts = Mapping[str, float]
"""What a decision depends on: an amount for each thing [cores]."""

# the loop waits so long after a transition [s]: loads are means over a second
SETTLE = 2.0
# when nothing can be done, it thinks again after a time that doubles up to the longest
FIRST_BACKOFF, LONGEST_BACKOFF = 2.0, 300.0
# this wait ends after this time [s] when amounts have changed ...
CHANGED_AFTER = 0.5
# ... by this share, and by more than this [cores]
_CHANGED, _NOTICEABLE = 0.1, 0.05
# a component does not return to a computer for this time [s]; then twice as long
STAY_AWAY = 300.0
# after this time [s] it stays away for the first, shortest time again
FORGET_QUARANTINE = 600.0
# the most components that move within a minute
BUDGET = 60
_MINUTE = 60.0


class Backoff:
    """When something in vain is tried again: after a time [s] that doubles."""

    def __init__(self, first: float, longest: float) -> None:
        self._first, self._longest = first, longest
        self.reset()

    def reset(self, at: float = -inf) -> None:
        """Try again at a time, and after the first, shortest time then."""
        self.again_at, self._pause = at, self._first

    def start(self, now: float) -> float:
        """Try again after a time, and return it."""
        pause, self._pause = self._pause, min(2 * self._pause, self._longest)
        self.again_at = now + pause
        return pause


def has_changed(before: Amounts, now: Amounts) -> bool:
    """Return whether a decision may be another one now."""
    return before.keys() != now.keys() or any(
        abs(now[name] - amount) > max(_NOTICEABLE, _CHANGED * max(amount, now[name]))
        for name, amount in before.items()
    )


class MoveLimits:
    """What the loop did lately, and so whether it may act now; times are in [s]."""

    def __init__(self) -> None:
        self._settled_at = -inf
        self._backoff = Backoff(FIRST_BACKOFF, LONGEST_BACKOFF)
        self._moves: deque[float] = deque()
        self._left: dict[tuple[str, str], Backoff] = {}
        self._in_vain: tuple[float, Amounts] | None = None

    def is_backing_off(self, now: float, amounts: Amounts | None = None) -> bool:
        """Return whether a move settles, or nothing can be done for these amounts."""
        if self._in_vain is not None and amounts is not None:
            at, before = self._in_vain
            if now >= at + CHANGED_AFTER and has_changed(before, amounts):
                self.reset_backoff()
        return now < max(self._settled_at, self._backoff.again_at)

    def may_move(self, number: int, now: float) -> bool:
        """Return whether `number` components may move within the budget."""
        while self._moves and now - self._moves[0] >= _MINUTE:
            self._moves.popleft()
        return len(self._moves) + number <= BUDGET

    def quarantined(self, now: float) -> dict[str, set[str]]:
        """Return component -> computers to which it may not return yet."""
        away: dict[str, set[str]] = {}
        for (component, computer), backoff in self._left.items():
            if now < backoff.again_at:
                away.setdefault(component, set()).add(computer)
        return away

    def start_backoff(self, now: float, amounts: Amounts | None = None) -> None:
        """Remember that nothing could be done about what is wrong."""
        self._in_vain = None if amounts is None else (now, amounts)
        self._backoff.start(now)

    def reset_backoff(self) -> None:
        """Think at once about what goes wrong next: nothing is wrong now."""
        self._backoff.reset()

    def note(self, steps: Iterable[TransitionStep], now: float) -> None:
        """Remember a transition, whether it went well or not."""
        self.reset_backoff()
        self._settled_at = now + SETTLE
        steps = tuple(steps)
        self._moves.extend(now for step in steps if step.target)
        for component, (source, target) in _paths(steps).items():
            if not source or not target or source == target:
                continue
            backoff = self._left.setdefault(
                (component, source), Backoff(STAY_AWAY, inf)
            )
            if now - backoff.again_at >= FORGET_QUARANTINE:
                backoff.reset()
            backoff.start(now)


def _paths(steps: Iterable[TransitionStep]) -> dict[str, tuple[str, str]]:
    """Return from where to where components go; a cold move is a stop and a start."""
    moves: dict[str, tuple[str, str]] = {}
    for step in steps:
        source, _ = moves.get(step.component, (step.source, ""))
        moves[step.component] = source, step.target
    return moves


FORGET_AFTER = 600.0
"""After so long without a symptom [s] what was lost before counts no more."""
JUDGE_AFTER = 2.0
"""What a change has gained is looked at after this time [s]: loads are means."""
MOST_DOUBT = 1024.0
"""Costs never count more times."""


class LossSuffered:
    """What was lost because a better placement was not taken; times are in [s]."""

    def __init__(self) -> None:
        self.lost = 0.0  # since the last change [core-seconds]
        self.doubt = 1.0  # how many times costs count, >= 1
        self._change: _Change | None = None
        self._gain = 0.0
        self._at: float | None = None
        self._begins = self._ended = -inf

    def note(self, gain: float, since: float, now: float) -> None:
        """Note what the best change would gain now [cores]; it is wrong `since` [s]."""
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
        return now + (cost - self.lost) / self._gain if self._gain > 0 else inf

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

        `undone`: work that is not done before [cores]; `gain`: by how much that should
        fall [cores]; 0: nothing moves, so there is nothing to be judged.
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
