"""The loop of adaptation: monitors, analyses, plans and executes.

What it looks for, and what it does then, are the robot's policies. It is carried out by
the manager's one thread, between commands. Everything it sees, decides and does is in
the journal.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial

from msgspec import Struct
from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import PoiseError
from poise.manage.adaptation.actions import Actions
from poise.manage.adaptation.decision import Decision, decide
from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.move_limits import MoveLimits
from poise.manage.adaptation.policy.evaluation import Key, Policies, Symptom
from poise.manage.adaptation.policy.subjects import values_of
from poise.manage.adaptation.proposals import Proposal, WhatIf
from poise.manage.adaptation.replan import propose
from poise.manage.adaptation.shortages.failover import fail_over
from poise.manage.adaptation.shortages.missing_functions import Needs, lacking
from poise.manage.adaptation.shortages.put_aside import CALM, PutAside
from poise.manage.adaptation.what_if import alternatives, what_if
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.report import TransitionReport, TransitionStep
from poise.manage.migration.transition_run import start_together, transit
from poise.manage.observe.deviations import Deviation
from poise.model.policy.policy import Do
from poise.model.policy.seen import Seen
from poise.model.policy.shipped import policies_of
from poise.units import counted

_ROOM_EVERY = 5.0
"""Whether components of a lost computer fit meanwhile is tried this often [s]."""


class Adaptation:
    """Watches a running robot, and changes its placement when that helps.

    Parameters
    ----------
    facts
        Returns what is known now.
    put_aside
        What does not run because not all fits.
    acts
        Whether it changes anything; else it only reports what is wrong.
    keep
        Takes what policies see, to record it; None: that is not computed.
    clock
        A time that never goes back [s].

    Attributes
    ----------
    deviations
        What is wrong now, and has lasted.
    """

    def __init__(
        self,
        run: RunningComponents,
        facts: Callable[[], Facts],
        put_aside: PutAside,
        *,
        acts: bool = True,
        keep: Callable[[Seen], object] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._run = run
        self._read = facts
        self._put_aside = put_aside
        self._acts = acts
        self._keep = keep
        self._clock = clock
        self._policies = Policies(policies_of(run.robot), run.robot.folder)
        self._move_limits = MoveLimits()
        self._needs = Needs(run.journal)
        self._actions = Actions(run, put_aside, self._move_limits)
        self._failover_limits = MoveLimits()
        self._troubles: set[str] = set()
        self._downtimes: dict[str, float] = {}
        self._reported: dict[Key, _Reported] = {}
        self._missing: set[str] = set()
        self._tries_again = float("inf")
        self._lost: frozenset[str] = frozenset()
        self._back: dict[str, float] = {}
        self.deviations: tuple[Deviation, ...] = ()

    def look(self) -> None:
        """Look at the robot once, and act if that is worth it."""
        now, facts = self._clock(), self._facts()
        read = cache(partial(values_of, facts))
        if self._keep is not None:
            self._keep(Seen.by(read, now))
        symptoms = self._policies.look(read, now)
        missing = self._needs.look(facts, now)
        self._back |= dict.fromkeys(self._lost - facts.lost, now)
        self._lost = facts.lost
        self._report(symptoms)
        self._put_aside.look()
        if not self._acts:
            return
        lost = _about(symptoms, "fail over")
        if not self._failover_limits.rests(now) and self._fail_over(
            facts, {each.values.name for each in lost}, now
        ):
            return
        if missing and self._put_aside.hold(facts, lacking(facts.task, missing), now):
            return
        if self._act(self._policies.due(symptoms, now), facts, now):
            return
        bad = _about(symptoms, "replan")
        if self._put_aside.take_back(facts, now, is_calm=not bad, missing=missing):
            return
        if not bad:
            self._move_limits.forget_nothing()
            self._use_again(facts, now)
            return
        links = (s.values.name for s in bad if s.policy.for_each == "link")
        facts = replace(facts, bad_links=frozenset(links))
        due = self._policies.due(bad, now)
        if due and not self._move_limits.rests(now, facts.situation()):
            decision = decide(facts, self._move_limits.barred(now))
            self._carry_out(decision, due, facts, now)

    def balance(
        self, move: float, *, dry: bool
    ) -> tuple[Proposal, TransitionReport | None]:
        """Change the placement for a person who asks, whatever it gains.

        Parameters
        ----------
        move
            What F grows by for each move, plus as much for each MB of state.
        dry
            Whether to propose only.

        Raises
        ------
        RobotError
            Nothing fits, or there is no way to what does.
        """
        facts = self._facts().within_reach()
        if not dry:
            self._put_aside.forgive()
        proposal = propose(facts, facts.robot_left(), move)
        if dry or not proposal.steps:
            return proposal, None
        what = f"asked to balance: {counted(len(proposal.steps), 'step')}"
        self._run.journal.note(
            "decided",
            what,
            proposal=proposal,
            alternatives=alternatives(facts),
            loads=facts.loads,
        )
        return proposal, self._transit(proposal.steps, self._clock())

    def what_if(self, component: str, computer: str) -> WhatIf:
        """Return what a move would change, for a person who asks.

        Raises
        ------
        UsageError
            There is no such component or computer.
        """
        return what_if(self._facts(), component, computer)

    def note_asked(self, component: str, computer: str) -> None:
        """Journal that a person asks for a move, and what else could be done."""
        facts = self._facts()
        try:
            change = what_if(facts, component, computer)
        except PoiseError:  # the move itself says why not
            return
        what = f"asked to move '{component}' to '{computer}'"
        others = alternatives(facts)
        self._run.journal.note("seen", what, what_if=change, alternatives=others)

    def _facts(self) -> Facts:
        return replace(self._read(), downtimes=self._downtimes)

    def close(self) -> None:
        """End what policies have started."""
        self._policies.close()

    def _act(self, due: Iterable[Symptom], facts: Facts, now: float) -> bool:
        """Carry out the action of one policy about one subject, if there is any."""
        symptom = next((s for s in due if self._actions.knows(s.policy.do)), None)
        if symptom is None:
            return False
        self._policies.note_acted([symptom], now)
        note, policy = self._run.journal.note, symptom.policy
        what = f"policy '{policy.name}': {policy.do} '{symptom.values.name}'"
        note("decided", f"{what}: {symptom.what}", policies=_seen([symptom]))
        try:
            self._actions.take(symptom, facts, now)
        except PoiseError as error:
            note("failed", f"{what}: {error}")
        return True

    def _fail_over(self, facts: Facts, lost: set[str], now: float) -> bool:
        """Restart the components of lost computers elsewhere, once."""
        stranded = {n for n, c in facts.placement.items() if c in lost}
        self._missing &= stranded
        if stranded <= self._missing and now < self._tries_again:
            return False
        found = fail_over(facts, lost)
        before, self._missing = self._missing, set(found.missing)
        self._tries_again = now + _ROOM_EVERY if found.waits_for_room else float("inf")
        note = self._run.journal.note
        for component, why in sorted(found.missing.items()):
            if component in before:
                continue
            where = facts.placement[component]
            note("wrong", f"component '{component}' of '{where}' is missing: {why}")
        if found.aside:
            why = "components of a lost computer that have a higher priority need room"
            self._put_aside.put(found.aside, why, now)
        if found.placement:
            note("decided", _sentence(found.placement), placement=found.placement)
            if start_together(self._run, found.placement, lost):
                self._failover_limits.forget_nothing()
            else:
                self._failover_limits.note_nothing(now)
        return bool(found.placement or self._missing - before)

    def _use_again(self, facts: Facts, now: float) -> None:
        """Think once about each computer that is back, when nothing is wrong.

        By then what components need there, and beside it, has been measured again.
        """
        found = [
            name
            for name, at in self._back.items()
            if now - at >= CALM and name not in facts.lost
        ]
        if not found or self._move_limits.rests(now):
            return
        for name in found:
            del self._back[name]
        decision = decide(facts, self._move_limits.barred(now))
        is_better = decision.acts or decision.proposal is not None
        why = decision.why if is_better else "all that runs has what it needs"
        names = " and ".join(f"'{name}'" for name in found)
        self._run.journal.note("seen", f"{names} may be used again: {why}")
        if decision.acts:
            self._carry_out(decision, (), facts, now)

    def _carry_out(
        self, decision: Decision, due: tuple[Symptom, ...], facts: Facts, now: float
    ) -> None:
        steps = decision.proposal.steps if decision.proposal else ()
        why = decision.why
        if decision.acts and not self._move_limits.may_move(len(steps), now):
            why = f"the {len(steps)} moves it takes are over the budget of a minute"
        elif decision.acts:
            note = self._run.journal.note
            note(
                "decided",
                why,
                decision=decision,
                alternatives=alternatives(facts),
                policies=_seen(due),
                loads=facts.loads,
            )
            self._policies.note_acted(due, now)
            report = self._transit(steps, now)
            if report.committed and decision.proposal:
                self._put_aside.note(decision.proposal.aside, why, now)
            return
        self._move_limits.note_nothing(now, facts.situation())
        self._report_why_not(why, decision, facts)

    def _transit(
        self, steps: tuple[TransitionStep, ...], now: float
    ) -> TransitionReport:
        self._move_limits.note(steps, now)
        report = transit(self._run, steps)
        self._downtimes |= {m.what: m.downtime for m in report.moves}
        return report

    def _report(self, symptoms: tuple[Symptom, ...]) -> None:
        """Journal each symptom when it has lasted, and when it has ended."""
        note = self._run.journal.note
        troubles = {*self._policies.troubles()}
        for trouble in sorted(troubles - self._troubles):
            note("wrong", trouble)
        self._troubles = troubles
        for symptom in symptoms:
            # a computer that is out of reach is reported as such (`LostComputers`)
            if symptom.key not in self._reported and symptom.policy.do != "fail over":
                self._reported[symptom.key] = _Reported(symptom, wall_time())
                note("wrong", symptom.what, policies=_seen([symptom]))
        for key in self._reported.keys() - self._policies.since.keys():
            note("right", f"no more: {self._reported.pop(key).symptom.what}")
        self.deviations = (
            *self._needs.deviations(),
            *(
                Deviation(
                    what=reported.symptom.what,
                    computer=reported.symptom.computer,
                    since=reported.since,
                )
                for reported in self._reported.values()
            ),
        )

    def _report_why_not(self, why: str, decision: Decision, facts: Facts) -> None:
        """Journal why nothing is done, once for each reason while symptoms last."""
        if any(reported.why_not != why for reported in self._reported.values()):
            for reported in self._reported.values():
                reported.why_not = why
            others = alternatives(facts)
            note = self._run.journal.note
            note("seen", why, decision=decision, alternatives=others)


def _about(symptoms: Iterable[Symptom], do: Do) -> tuple[Symptom, ...]:
    """Return the symptoms about which something is to be done."""
    return tuple(each for each in symptoms if each.policy.do == do)


def _seen(symptoms: Iterable[Symptom]) -> list[dict[str, object]]:
    """Return policies and the values that they saw, for the journal."""
    return [{"policy": each.policy.name, "saw": each.values} for each in symptoms]


def _sentence(placement: Mapping[str, str]) -> str:
    where = ", ".join(f"'{c}' on '{at}'" for c, at in sorted(placement.items()))
    what = "components of a lost computer restart, from checkpoints or without state"
    return f"{what}: {where}"


class _Reported(Struct):
    """A symptom as it was reported, since when [s since 1970], and why it stays."""

    symptom: Symptom
    since: float
    why_not: str = ""
