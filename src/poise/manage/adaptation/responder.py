"""What a responder is: it sees a situation, and says what should change.

After a transition it rests until what has changed is measured. At most `BUDGET`
components move in a minute. What policies of the user move does not return to a
computer that it left, for a time that doubles; what the loop itself decides is limited
by what it costs (`LossSuffered`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from msgspec import Struct

from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.desired import Desired
from poise.manage.migration.migration_report import TransitionStep


class Change(Struct, frozen=True, kw_only=True):
    """What a responder wants done; nothing of it has happened yet."""

    carry_out: Callable[[], object]
    why: str = ""  # the decision, for the journal; empty: what carries it out says it
    facts: Mapping[str, object] = {}  # what led to it, for the journal


class Responder(Protocol):
    """Reacts to one kind of trouble. Changes nothing by itself, and never waits."""

    @property
    def purpose(self) -> str:
        """Return what it is there for."""
        ...

    def respond(self, situation: Situation, desired: Desired) -> Change | None:
        """Return what should change; None: nothing, so the next responder is asked."""
        ...


REST = 2.0
"""The loop rests for so long after a transition [s]: loads are means over a second."""
LONGEST_REST = 300.0
"""When nothing can be done, it is thought about again after this time at most [s]."""
FORGET_AFTER = 600.0
"""After so long [s] a component stays away for as short as the first time."""
STAY_AWAY = 300.0
"""A component does not return to a computer for so long [s]; then twice as long."""
BUDGET = 60
"""The most components that move within a minute."""
THINK_AGAIN = 2.0
"""When nothing can be done, it is thought about again after this time [s]; then after
twice as long, up to `LONGEST_REST`."""
CHANGED_AFTER = 0.5
"""After this time already, when the amounts is another one [s]: loads are means."""
_MINUTE = 60.0


Amounts = Mapping[str, float]
"""What a decision depends on: an amount for each thing [cores]."""
_CHANGED = 0.1
"""It is another one when an amount has changed by this share, and `_NOTICEABLE`."""
_NOTICEABLE = 0.05
"""[cores]"""


def has_changed(before: Amounts, now: Amounts) -> bool:
    """Return whether a decision may be another one now."""
    return before.keys() != now.keys() or any(
        abs(now[name] - amount) > max(_NOTICEABLE, _CHANGED * max(amount, now[name]))
        for name, amount in before.items()
    )


class MoveLimits:
    """What the loop did lately, and so whether it may act now.

    All times are of one clock that never goes back [s].
    """

    def __init__(self) -> None:
        self._rests_until = 0.0
        self._think_again = THINK_AGAIN
        self._moves: deque[float] = deque()
        self._left: dict[tuple[str, str], tuple[float, float]] = {}
        self._in_vain: tuple[float, Amounts] | None = None

    def is_backing_off(self, now: float, amounts: Amounts | None = None) -> bool:
        """Return whether nothing is done yet, after a transition or in vain.

        `amounts`: what is thought about; when it is another than that in which nothing
        could be done, that is thought about soon.
        """
        if self._in_vain is not None and amounts is not None:
            at, before = self._in_vain
            if now >= at + CHANGED_AFTER and has_changed(before, amounts):
                self.reset_backoff()
                return False
        return now < self._rests_until

    def may_move(self, number: int, now: float) -> bool:
        """Return whether `number` components may move within the budget."""
        while self._moves and now - self._moves[0] >= _MINUTE:
            self._moves.popleft()
        return len(self._moves) + number <= BUDGET

    def quarantined(self, now: float) -> dict[str, set[str]]:
        """Return component -> computers to which it may not return yet."""
        found: dict[str, set[str]] = {}
        for (component, computer), (until, _) in self._left.items():
            if now < until:
                found.setdefault(component, set()).add(computer)
        return found

    def start_backoff(self, now: float, amounts: Amounts | None = None) -> None:
        """Remember that nothing could be done about what is wrong."""
        self._in_vain = None if amounts is None else (now, amounts)
        self._rests_until = now + self._think_again
        self._think_again = min(2 * self._think_again, LONGEST_REST)

    def reset_backoff(self) -> None:
        """Think at once about what goes wrong next: nothing is wrong now."""
        self._think_again = THINK_AGAIN
        self._in_vain = None

    def note(self, steps: Iterable[TransitionStep], now: float) -> None:
        """Remember a transition, whether it went well or not."""
        self.reset_backoff()
        self._rests_until = now + REST
        steps = tuple(steps)
        self._moves.extend(now for step in steps if step.target)
        for component, (source, target) in _moves(steps).items():
            if not source or not target or source == target:
                continue
            key = component, source
            until, away = self._left.get(key, (0.0, STAY_AWAY / 2))
            forgotten = now - until >= FORGET_AFTER
            away = STAY_AWAY if forgotten else 2 * away
            self._left[key] = now + away, away


def _moves(steps: Iterable[TransitionStep]) -> dict[str, tuple[str, str]]:
    """Return from where to where components go; a cold move is a stop and a start."""
    moves: dict[str, tuple[str, str]] = {}
    for step in steps:
        source, _ = moves.get(step.component, (step.source, ""))
        moves[step.component] = source, step.target
    return moves
