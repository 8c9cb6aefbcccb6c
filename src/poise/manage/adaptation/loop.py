"""The loop of adaptation: monitor, analyse, plan, execute.

Carried out by the manager's one thread, between commands. Everything it sees, decides
and does is in the journal.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from poise.manage.adaptation.decision import Decision, decide
from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.restraint import Restraint
from poise.manage.adaptation.triggers import TRIGGERS, Lasting, Symptom
from poise.manage.migration.transition_run import transit
from poise.manage.run import Run


class Adaptation:
    """Changes the placement by itself when that mends something.

    Parameters
    ----------
    facts
        Returns what is known now.
    clock
        A time that never goes back [s].
    """

    def __init__(
        self,
        run: Run,
        facts: Callable[[], Facts],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._run = run
        self._facts = facts
        self._clock = clock
        self._lasting = Lasting()
        self._restraint = Restraint()
        self._downtimes: dict[str, float] = {}
        self._told: dict[tuple[str, str], str] = {}
        self.symptoms: tuple[Symptom, ...] = ()
        """What is wrong now, and has lasted."""

    def look(self) -> None:
        """Look at the robot once, and act if that is worth it."""
        now, facts = self._clock(), self._facts()
        found = [symptom for trigger in TRIGGERS for symptom in trigger(facts)]
        self.symptoms = self._lasting.select(found, now)
        self._tell_ended()
        self._tell_new()
        if not self.symptoms:
            self._restraint.forget_nothing()
        elif not self._restraint.rests(now):
            decision = decide(facts, self._restraint.barred(now), self._downtimes)
            self._carry_out(decision, facts, now)

    def _carry_out(self, decision: Decision, facts: Facts, now: float) -> None:
        proposal = decision.proposal
        number = len(proposal.steps) if proposal else 0
        if not decision.acts or proposal is None:
            self._restraint.note_nothing(now)
            self._tell_once(decision.why, decision)
        elif not self._restraint.may_move(number, now):
            self._restraint.note_nothing(now)
            self._tell_once(f"{number} moves are over the budget of a minute", decision)
        else:
            self._run.journal.note(
                "decided", decision.why, decision=decision, loads=facts.loads
            )
            self._restraint.note(proposal.steps, now)
            report = transit(self._run, proposal.steps)
            self._downtimes |= {m.component: m.downtime for m in report.moves}

    def _tell_new(self) -> None:
        for symptom in self.symptoms:
            if symptom.key not in self._told:
                self._told[symptom.key] = ""
                self._run.journal.note("wrong", symptom.what)

    def _tell_ended(self) -> None:
        for key in self._told.keys() - self._lasting.since.keys():
            del self._told[key]
            trigger, about = key
            self._run.journal.note("right", f"no more {trigger} of '{about}'")

    def _tell_once(self, why: str, decision: Decision) -> None:
        """Journal why nothing is done, once for each cause while symptoms last."""
        if any(self._told.get(symptom.key) != why for symptom in self.symptoms):
            self._told |= {symptom.key: why for symptom in self.symptoms}
            self._run.journal.note("seen", why, decision=decision)
