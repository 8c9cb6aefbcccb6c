"""Changes the placement after a symptom, and when a computer is back.

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

from collections import deque
from collections.abc import Iterable, Mapping
from functools import partial
from typing import NamedTuple

from msgspec.structs import replace

from poise.manage.adaptation.decision import HORIZON, Decision, decide
from poise.manage.adaptation.move_forecast import alternatives
from poise.manage.adaptation.policies import Key, Policies, Symptom, saw
from poise.manage.adaptation.situation import Change, Situation
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.migration_report import TransitionReport, TransitionStep
from poise.manage.migration.transition_run import transit
from poise.manage.shortages.suspension import CALM, Suspensions

SETTLE = 2.0
"""The loop waits so long after a transition [s]: loads are means over a second."""
LONGEST_BACKOFF = 300.0
"""The longest time until the loop thinks again when nothing can be done [s]."""
FORGET_QUARANTINE = 600.0
"""After this time [s] a component stays away for the first, shortest time again."""
STAY_AWAY = 300.0
"""A component does not return to a computer for this time [s]; then twice as long."""
BUDGET = 60
"""The most components that move within a minute."""
FIRST_BACKOFF = 2.0
"""The first such time [s]; it doubles up to `LONGEST_BACKOFF`."""
CHANGED_AFTER = 0.5
"""The backoff ends after this time [s] when the amounts have changed."""
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
    """What the loop did lately, and so whether it may act now; times are in [s]."""

    def __init__(self) -> None:
        self._idle_until = 0.0
        self._backoff = FIRST_BACKOFF
        self._moves: deque[float] = deque()
        self._left: dict[tuple[str, str], tuple[float, float]] = {}
        self._in_vain: tuple[float, Amounts] | None = None

    def is_backing_off(self, now: float, amounts: Amounts | None = None) -> bool:
        """Return whether to wait: a transition settles, or nothing could be done.

        The second ends when `amounts` have changed since.
        """
        if self._in_vain is not None and amounts is not None:
            at, before = self._in_vain
            if now >= at + CHANGED_AFTER and has_changed(before, amounts):
                self.reset_backoff()
                return False
        return now < self._idle_until

    def may_move(self, number: int, now: float) -> bool:
        """Return whether `number` components may move within the budget."""
        while self._moves and now - self._moves[0] >= _MINUTE:
            self._moves.popleft()
        return len(self._moves) + number <= BUDGET

    def quarantined(self, now: float) -> dict[str, set[str]]:
        """Return component -> computers to which it may not return yet."""
        away: dict[str, set[str]] = {}
        for (component, computer), (until, _) in self._left.items():
            if now < until:
                away.setdefault(component, set()).add(computer)
        return away

    def start_backoff(self, now: float, amounts: Amounts | None = None) -> None:
        """Remember that nothing could be done about what is wrong."""
        self._in_vain = None if amounts is None else (now, amounts)
        self._idle_until = now + self._backoff
        self._backoff = min(2 * self._backoff, LONGEST_BACKOFF)

    def reset_backoff(self) -> None:
        """Think at once about what goes wrong next: nothing is wrong now."""
        self._backoff = FIRST_BACKOFF
        self._in_vain = None

    def note(self, steps: Iterable[TransitionStep], now: float) -> None:
        """Remember a transition, whether it went well or not."""
        self.reset_backoff()
        self._idle_until = now + SETTLE
        steps = tuple(steps)
        self._moves.extend(now for step in steps if step.target)
        for component, (source, target) in _paths(steps).items():
            if not source or not target or source == target:
                continue
            key = component, source
            until, stay = self._left.get(key, (0.0, STAY_AWAY / 2))
            forgotten = now - until >= FORGET_QUARANTINE
            stay = STAY_AWAY if forgotten else 2 * stay
            self._left[key] = now + stay, stay


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
    """What was lost because a better placement was not taken.

    Times are of one clock [s].

    `lost`: since the last change [core-seconds]; `doubt`: how many times a cost counts,
    >= 1: twice more after each change in vain.
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

        `since`: when it began that something is wrong [s].
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


_THINK_EVERY = 0.5
"""While a change is not worth its cost yet, it is thought about so often [s]."""


class Transitions:
    """The transitions that the loop made, and what limits the next one.

    `downtimes`: component -> the downtime of its last move [s].
    """

    def __init__(
        self, run: RunningComponents, policies: Policies, suspensions: Suspensions
    ) -> None:
        self.run = run
        self.limits = MoveLimits()
        self.downtimes: dict[str, float] = {}
        self.loss = LossSuffered()
        self._policies = policies
        self._suspensions = suspensions

    def due(self, symptoms: tuple[Symptom, ...], now: float) -> tuple[Symptom, ...]:
        """Return the symptoms about which something may be done now."""
        return self._policies.due(symptoms, now)

    def began(self, symptoms: tuple[Symptom, ...], now: float) -> float:
        """Return when the first of the symptoms was seen first."""
        return min(self._policies.since.get(symptom.key, now) for symptom in symptoms)

    def carry_out(
        self, steps: tuple[TransitionStep, ...], now: float
    ) -> TransitionReport:
        """Take the steps, and remember that."""
        self.limits.note(steps, now)
        report = transit(self.run, steps)
        self.downtimes |= {m.what: m.downtime for m in report.moves}
        return report

    def change(
        self, decision: Decision, due: tuple[Symptom, ...], situation: Situation
    ) -> Change:
        """Return a decision that acts, as a change."""
        return Change(
            why=decision.why,
            facts={
                "decision": decision,
                "alternatives": alternatives(situation),
                "policies": saw(due),
                "loads": situation.loads,
            },
            carry_out=partial(self._act, decision, due, situation.now),
        )

    def _act(self, decision: Decision, due: tuple[Symptom, ...], now: float) -> None:
        proposal = decision.proposal
        self._policies.note_acted(due, now)
        self.loss.note_change(decision.undone, decision.gain, now)
        report = self.carry_out(proposal.steps if proposal else (), now)
        if report.committed and proposal:
            self._suspensions.note_suspended(proposal.suspended, decision.why, now)

    def why_not(self, decision: Decision, now: float) -> str:
        """Return why a decision is not carried out; empty: it is."""
        steps = decision.proposal.steps if decision.proposal else ()
        if not decision.acts:
            return decision.why
        if not self.limits.may_move(len(steps), now):
            return f"the {len(steps)} moves it takes are over the budget of a minute"
        return ""


class Replan:
    """Decides on another placement while something is wrong that one may mend."""

    purpose = "plan again"

    def __init__(self, transitions: Transitions) -> None:
        self._transitions = transitions
        self._said: dict[Key, str] = {}
        self._think_at = 0.0

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return the transition to a better placement, if that is worth it."""
        limits, now = self._transitions.limits, situation.now
        bad = situation.about("replan")
        self._said = {
            symptom.key: self._said.get(symptom.key, "")
            for symptom in situation.symptoms
        }
        if not bad:
            limits.reset_backoff()
            self._transitions.loss.end(now)
            return None
        links = (s.values.name for s in bad if s.policy.for_each == "link")
        situation = replace(situation, bad_links=frozenset(links))
        due = self._transitions.due(bad, now)
        if (
            not due
            or now < self._think_at
            or limits.is_backing_off(now, situation.amounts())
        ):
            return None
        began = self._transitions.began(bad, now)
        loss = self._transitions.loss
        horizon = max(HORIZON, loss.lasts(began, now))
        decision = decide(situation, horizon=horizon, doubt=loss.doubt)
        loss.judge(decision.undone, now)
        loss.note(decision.gain if decision.acts else 0.0, began, now)
        why_not = self._transitions.why_not(decision, now)
        if not why_not:
            earned_at = loss.earned_at(loss.doubt * decision.cost, now)
            if earned_at <= now:
                return self._transitions.change(decision, due, situation)
            self._think_at = min(earned_at, now + _THINK_EVERY)
            return None
        limits.start_backoff(now, situation.amounts())
        self._say_why_not(why_not, decision, situation)
        return None

    def _say_why_not(self, why: str, decision: Decision, situation: Situation) -> None:
        """Journal why nothing is done, once for each reason while symptoms last."""
        if any(said != why for said in self._said.values()):
            self._said = dict.fromkeys(self._said, why)
            others = alternatives(situation)
            note = self._transitions.run.journal.note
            note("seen", why, decision=decision, alternatives=others)


class UseAgain:
    """Thinks once about each computer that is back, when nothing is wrong.

    By then what components need there, and beside it, has been measured again.
    """

    purpose = "use computers that are back"

    def __init__(self, transitions: Transitions) -> None:
        self._transitions = transitions
        self._lost: frozenset[str] = frozenset()
        self._back: dict[str, float] = {}

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return a transition that uses what is back, if that is worth it."""
        limits, now = self._transitions.limits, situation.now
        self._back |= dict.fromkeys(sorted(self._lost - situation.lost), now)
        self._lost = situation.lost
        back = [
            name
            for name, at in self._back.items()
            if now - at >= CALM and name not in situation.lost
        ]
        if not back or situation.about("replan") or limits.is_backing_off(now):
            return None
        for name in back:
            del self._back[name]
        decision = decide(situation)
        why_not = self._transitions.why_not(decision, now)
        is_better = decision.acts or decision.proposal is not None
        why = (
            decision.why
            if is_better
            else "every running component has the CPU that it needs"
        )
        names = " and ".join(f"'{name}'" for name in back)
        note = self._transitions.run.journal.note
        note("seen", f"{names} may be used again; {why}")
        if not decision.acts or why_not:
            return None
        return self._transitions.change(decision, (), situation)
