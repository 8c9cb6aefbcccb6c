"""The loop of adaptation: monitors, analyses, plans and executes.

Each look makes one `Situation`. The responders are asked in the order of their table,
and the change of the first that wants one is carried out, by the manager's one thread.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import cache, partial

from msgspec import Struct
from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import PoiseError, UsageError, last_error
from poise.manage.adaptation.actions import Actions, component_of
from poise.manage.adaptation.bad_links import check_links
from poise.manage.adaptation.move_forecast import alternatives, check_move, what_if
from poise.manage.adaptation.placement_responders import (
    FailoverResponder,
    ReplanResponder,
    Transitions,
    UseAgainResponder,
)
from poise.manage.adaptation.policies import Key, Policies, Symptom, saw
from poise.manage.adaptation.policy_values import values_of
from poise.manage.adaptation.proposal import propose
from poise.manage.adaptation.situation import Responder, Situation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.migration_report import Proposal, TransitionReport, WhatIf
from poise.manage.observe.deviations import Deviation
from poise.manage.shortages.suspension import (
    CALM,
    NeededFunctions,
    ResumeSuspended,
    StopWithoutNeeded,
    Suspensions,
)
from poise.model.policy import Seen, policies_of
from poise.units import counted

_TRACEBACK = "Traceback (most recent call last):"
_WELL_EVERY = 0.5
"""While nothing is wrong the robot is looked at this often [s]."""


class _Reported(Struct):
    """A symptom that was reported, and when its condition held last [s]."""

    symptom: Symptom  # as it was first
    deviation: Deviation  # as it was last
    held_at: float


class Adaptation:
    """Watches a running robot, and changes its placement when that helps."""

    def __init__(
        self,
        live: LiveRobot,
        read: Callable[[], Situation],
        suspensions: Suspensions,
        *,
        acts: bool = True,  # else it only reports what is wrong
        keep: Callable[[Seen], object] | None = None,  # gets what policies see
        is_well: Callable[[], bool] = lambda: False,  # then it looks less often
        clock: Callable[[], float] = time.monotonic,  # a time that never goes back [s]
    ) -> None:
        self._live = live
        self._read = read
        self._suspensions = suspensions
        self._acts = acts
        self._keep = keep
        self._is_well = is_well
        self._clock = clock
        robot, policies = live.robot, policies_of(live.robot.policies)
        names = (component.name for component in robot.components())
        self._policies = Policies(policies, robot.folder, names)
        self._needs = NeededFunctions(live.journal)
        self._transitions = Transitions(live, self._policies, suspensions, clock)
        limits = self._transitions.limits
        self.responders: tuple[Responder, ...] = (
            FailoverResponder(live, suspensions),
            StopWithoutNeeded(suspensions),
            Actions(live, suspensions, limits, self._policies),
            ResumeSuspended(live, suspensions),
            ReplanResponder(self._transitions),
            UseAgainResponder(self._transitions),
        )
        self._troubles: dict[str, tuple[str, Deviation]] = {}
        """Policy -> what is wrong with its function, in full and in short."""
        self._reported: dict[Key, _Reported] = {}
        self._looked_at = -math.inf
        self.deviations: tuple[Deviation, ...] = ()
        self.hanging: tuple[str, ...] = ()
        """The components that policy `hang` is about now."""

    def adapt(self) -> None:
        """Look at the robot once, and let the first responder act that wants to."""
        is_early = self._clock() < self._looked_at + _WELL_EVERY
        if is_early and not self._policies.since and self._is_well():
            return
        situation = self._analysed(self._situation())
        self._looked_at = situation.now
        parts = self._live.parts
        parts.run("report symptoms", partial(self._report, situation))
        parts.run("see which architectures are suspended", self._suspensions.record)
        if self._acts:
            for responder in self.responders:
                respond = partial(self._respond, responder, situation)
                if parts.run(responder.purpose, respond, changes=True):
                    self._looked_at = -math.inf
                    return

    def _situation(self) -> Situation:
        downtimes = self._transitions.downtimes
        return replace(self._read(), downtimes=downtimes, now=self._clock())

    def _analysed(self, situation: Situation) -> Situation:
        """Return the situation with what policies say of it, and what is missing."""
        now, read = situation.now, cache(partial(values_of, situation))
        if self._keep is not None:
            self._keep(Seen.by(read, now))
        reported = situation.statuses.keys() | situation.lost
        lacks_some = any(c.name not in reported for c in situation.robot.computers)
        symptoms = self._policies.evaluate(read, now, lacks_some=lacks_some)
        missing = frozenset(self._needs.evaluate(situation, now))
        suspends = self._policies.suspends
        return replace(situation, symptoms=symptoms, missing=missing, suspends=suspends)

    def _respond(self, responder: Responder, situation: Situation) -> bool:
        """Carry out what a responder wants; return whether it wanted something."""
        change = responder.respond(situation, self._live.desired)
        if change is None:
            return False
        if change.why:
            self._live.journal.note("decided", change.why, **change.facts)
        change.carry_out()
        return True

    def balance(
        self, move: float, *, dry: bool
    ) -> tuple[Proposal, TransitionReport | None]:
        """Change the placement for a person who asks, whatever it gains."""
        situation = self._situation().of_running_components()
        if not dry:
            self._suspensions.release()
        proposal = propose(situation, move)
        if dry or not proposal.steps:
            return proposal, None
        what = f"asked to balance: {counted(len(proposal.steps), 'step')}"
        self._live.journal.note(
            "decided",
            what,
            proposal=proposal,
            alternatives=alternatives(situation),
            loads=situation.loads,
        )
        return proposal, self._transitions.carry_out(proposal.steps)

    def what_if(self, component: str, computer: str) -> WhatIf:
        """Return what a move would change; UsageError when it cannot be made."""
        if away := self._live.unreached().get(computer):
            raise UsageError(away)
        situation = self._situation()
        check_links(situation, component, computer)
        return what_if(situation, component, computer)

    def check_asked(self, component: str, computer: str, *, force: bool) -> None:
        """Check and journal a move that a person asks for; UsageError: refused."""
        situation = self._situation()
        check_links(situation, component, computer)
        if not force:
            check_move(situation, component, computer)
        try:
            change = what_if(situation, component, computer)
        except PoiseError:  # with what runs now, no placement can be judged
            return
        what = f"asked to move '{component}' to '{computer}'"
        others = alternatives(situation)
        self._live.journal.note("seen", what, what_if=change, alternatives=others)

    def close(self) -> None:
        """End what policies have started."""
        self._policies.close()

    def _report(self, situation: Situation) -> None:
        """Journal symptoms that have lasted, and that are gone for `CALM`."""
        note, now = self._live.journal.note, situation.now
        self._note_troubles(self._policies.troubles())
        for symptom in situation.symptoms:
            # a computer that is out of reach is reported as such (`LostComputers`)
            is_loss = symptom.policy.do == "fail over"
            is_loss = is_loss and symptom.values.name in situation.lost
            known = self._reported.get(symptom.key)
            if known is not None:
                known.deviation = replace(known.deviation, what=symptom.what)
            elif not is_loss:
                deviation = Deviation(
                    what=symptom.what, computer=symptom.computer, since=wall_time()
                )
                self._reported[symptom.key] = _Reported(symptom, deviation, now)
                note("wrong", symptom.what, policies=saw([symptom]))
        holding = self._policies.since
        for key, reported in sorted(self._reported.items()):
            if key in holding:
                reported.held_at = now
            elif now - reported.held_at >= CALM or _has_left(reported, situation):
                del self._reported[key]
                note("right", f"no more: {reported.symptom.what}")
        hangs = self._reported.keys() & holding.keys()
        self.hanging = tuple(sorted(key[1] for key in hangs if key[0] == "hang"))
        self.deviations = (
            *self._needs.deviations(),
            *(deviation for _, deviation in self._troubles.values()),
            *(reported.deviation for reported in self._reported.values()),
        )

    def _note_troubles(self, troubles: Mapping[str, str]) -> None:
        """Journal what is wrong with policies' functions, and what is not any more."""
        note, before = self._live.journal.note, self._troubles
        self._troubles = {}
        for name, trouble in troubles.items():
            known, first = before.get(name, ("", None))
            if trouble != known:
                note("wrong", trouble)
            since = first.since if first else wall_time()
            deviation = Deviation(what=_short(trouble), computer="", since=since)
            self._troubles[name] = trouble, deviation
        for name in before.keys() - troubles.keys():
            note("right", before[name][1].end())


def _has_left(reported: _Reported, situation: Situation) -> bool:
    """Return whether what was wrong with a component was so where it is no more."""
    symptom = reported.symptom
    if symptom.policy.for_each not in {"component", "timer"}:
        return False
    return situation.placement.get(component_of(symptom)) != symptom.computer


def _short(trouble: str) -> str:
    """Return a sentence with the end of its traceback in place of all of it."""
    what, is_long, _ = trouble.partition(_TRACEBACK)
    return f"{what}{last_error(trouble)}" if is_long else trouble
