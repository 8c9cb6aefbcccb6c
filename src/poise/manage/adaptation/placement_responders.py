"""Responders that change the placement: when something is wrong, or a computer is back.

`when_to_act` says when a change is worth its moves.
"""

from __future__ import annotations

from functools import partial

from msgspec.structs import replace

from poise.manage.adaptation.decision import HORIZON, Decision, decide
from poise.manage.adaptation.move_forecast import alternatives
from poise.manage.adaptation.policies import Key, Policies, Symptom, saw
from poise.manage.adaptation.situation import Change, Situation
from poise.manage.adaptation.when_to_act import LossSuffered, MoveLimits
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.migration_report import TransitionReport, TransitionStep
from poise.manage.migration.transition_run import transit
from poise.manage.shortages.suspension import CALM, Suspensions

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
            return f"the {len(steps)} moves that it takes exceed the limit of a minute"
        return ""


class ReplanResponder:
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


class UseAgainResponder:
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
