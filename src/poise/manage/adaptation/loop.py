"""The loop of adaptation: monitors, analyses, plans and executes.

Carried out by the manager's one thread, between commands. Everything it sees, decides
and does is in the journal.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from msgspec import Struct

from poise.manage.adaptation.decision import Decision, decide
from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.failover import fail_over
from poise.manage.adaptation.move_limits import MoveLimits
from poise.manage.adaptation.triggers import TRIGGERS, LastingSymptoms, Symptom
from poise.manage.migration.transition_run import restart_elsewhere, transit
from poise.manage.observe.deviations import Deviation
from poise.manage.run import Run


class Adaptation:
    """Watches a running robot, and changes its placement when that helps.

    Parameters
    ----------
    facts
        Returns what is known now.
    acts
        Whether it changes anything; else it only reports what is wrong.
    clock
        A time that never goes back [s].

    Attributes
    ----------
    deviations
        What is wrong now, and has lasted.
    """

    def __init__(
        self,
        run: Run,
        facts: Callable[[], Facts],
        *,
        acts: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._run = run
        self._facts = facts
        self._acts = acts
        self._clock = clock
        self._lasting = LastingSymptoms()
        self._move_limits = MoveLimits()
        self._failover_limits = MoveLimits()
        self._downtimes: dict[str, float] = {}
        self._reported: dict[tuple[str, str], _Reported] = {}
        self._missing: set[str] = set()
        self.deviations: tuple[Deviation, ...] = ()

    def look(self) -> None:
        """Look at the robot once, and act if that is worth it."""
        now, facts = self._clock(), self._facts()
        found = [symptom for trigger in TRIGGERS for symptom in trigger(facts)]
        symptoms = self._lasting.select(found, now)
        self._report(symptoms)
        if (
            self._acts
            and not self._failover_limits.rests(now)
            and self._fail_over(facts, now)
        ):
            return
        if not symptoms:
            self._move_limits.forget_nothing()
        elif self._acts and not self._move_limits.rests(now):
            decision = decide(facts, self._move_limits.barred(now), self._downtimes)
            self._carry_out(decision, facts, now)

    def _fail_over(self, facts: Facts, now: float) -> bool:
        """Restart the components of lost computers elsewhere, once."""
        stranded = {n for n, c in facts.placement.items() if c in facts.lost}
        self._missing &= stranded
        if stranded <= self._missing:
            return False
        found = fail_over(facts, facts.lost)
        self._missing = set(found.missing)
        note = self._run.journal.note
        for component, why in sorted(found.missing.items()):
            where = facts.placement[component]
            note("wrong", f"component '{component}' of '{where}' is missing: {why}")
        if found.placement:
            note("decided", _sentence(found.placement), placement=found.placement)
            if restart_elsewhere(self._run, found.placement):
                self._failover_limits.forget_nothing()
            else:
                self._failover_limits.note_nothing(now)
        return True

    def _carry_out(self, decision: Decision, facts: Facts, now: float) -> None:
        steps = decision.proposal.steps if decision.proposal else ()
        why = decision.why
        if decision.acts and not self._move_limits.may_move(len(steps), now):
            why = f"the {len(steps)} moves it takes are over the budget of a minute"
        elif decision.acts:
            note = self._run.journal.note
            note("decided", why, decision=decision, loads=facts.loads)
            self._move_limits.note(steps, now)
            report = transit(self._run, steps)
            self._downtimes |= {m.component: m.downtime for m in report.moves}
            return
        self._move_limits.note_nothing(now)
        self._report_why_not(why, decision)

    def _report(self, symptoms: tuple[Symptom, ...]) -> None:
        """Journal each symptom when it has lasted, and when it has ended."""
        note = self._run.journal.note
        for symptom in symptoms:
            if symptom.key not in self._reported:
                self._reported[symptom.key] = _Reported(symptom, time.time())
                note("wrong", symptom.what)
        for key in self._reported.keys() - self._lasting.since.keys():
            note("right", f"no more: {self._reported.pop(key).symptom.what}")
        self.deviations = tuple(
            Deviation(
                what=reported.symptom.what,
                computer=reported.symptom.computer,
                since=reported.since,
            )
            for reported in self._reported.values()
        )

    def _report_why_not(self, why: str, decision: Decision) -> None:
        """Journal why nothing is done, once for each reason while symptoms last."""
        if any(reported.why_not != why for reported in self._reported.values()):
            for reported in self._reported.values():
                reported.why_not = why
            self._run.journal.note("seen", why, decision=decision)


def _sentence(placement: Mapping[str, str]) -> str:
    where = ", ".join(f"'{c}' on '{at}'" for c, at in sorted(placement.items()))
    return f"components of a lost computer restart without their state: {where}"


class _Reported(Struct):
    """A symptom as it was reported, since when [s since 1970], and why it stays."""

    symptom: Symptom
    since: float
    why_not: str = ""
