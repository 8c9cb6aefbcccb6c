"""Responders that change the placement; `when_to_act` says when that is worth it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError
from poise.manage.adaptation.decision import (
    HORIZON,
    Decision,
    decide,
    urgent,
    with_bursts,
)
from poise.manage.adaptation.move_forecast import alternatives
from poise.manage.adaptation.policies import Key, Policies, Symptom, saw
from poise.manage.adaptation.proposal import explain
from poise.manage.adaptation.situation import Change, Homes, Situation
from poise.manage.adaptation.when_to_act import STAY_AWAY, LossSuffered, MoveLimits
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.coordinator import stuck_components
from poise.manage.migration.migration_report import TransitionReport, TransitionStep
from poise.manage.migration.transition_plan import plan_transition
from poise.manage.migration.transition_run import start_together, transit
from poise.manage.shortages.free_room import placed_beside
from poise.manage.shortages.suspension import CALM, Suspensions
from poise.model.check.allowed_computers import allowed_computers, pinned_components
from poise.model.robot import Architecture

_ROOM_EVERY = 5.0
"""Whether components of a lost computer fit meanwhile is tried this often [s]."""


class FailoverPlan(Struct, frozen=True, kw_only=True):
    """What becomes of the components of lost computers."""

    placement: Mapping[str, str]  # component -> the computer where it restarts
    missing: Mapping[str, str]  # component -> why it does not
    suspended: tuple[str, ...] = ()
    steps: tuple[TransitionStep, ...] = ()  # moves of what works that make room before


class FailoverResponder:
    """Restarts elsewhere what was on lost computers, once for each loss."""

    purpose = "restart components of lost computers"

    def __init__(self, live: LiveRobot, suspensions: Suspensions) -> None:
        self._live = live
        self._suspensions = suspensions
        self._limits = MoveLimits()
        self._missing: set[str] = set()
        self._try_at = 0.0

    def respond(self, situation: Situation, desired: Desired) -> Change | None:
        """Return where components restart, and what makes room for them."""
        now = situation.now
        asked = {symptom.values.name for symptom in situation.about("fail over")}
        lost = asked & situation.lost  # a policy may be about one that is up
        # one that failed says nothing of what can be done once others are lost or back
        if self._limits.is_backing_off(now, dict.fromkeys(lost, 1.0)):
            return None
        stranded = {n for n, c in situation.placement.items() if c in lost}
        self._missing &= stranded
        if not stranded or (stranded <= self._missing and now < self._try_at):
            return None
        failover = plan_failover(situation, lost, stuck_components(self._live))
        before, self._missing = self._missing, set(failover.missing)
        self._try_at = now + _ROOM_EVERY
        for name, why in sorted(failover.missing.items()):
            if name not in before:
                where = desired.placed[name].computer
                what = f"component '{name}' of '{where}' is missing: {why}"
                self._live.journal.note("wrong", what)
        if not failover.placement:
            return None
        restart = sorted(failover.placement.items())
        where = ", ".join(f"'{name}' on '{at}'" for name, at in restart)
        return Change(
            why=f"components of a lost computer restart: {where}",
            facts={"placement": failover.placement, "moves": failover.steps},
            carry_out=partial(self._restart, failover, lost, now),
        )

    def _restart(
        self, failover: FailoverPlan, lost: Collection[str], now: float
    ) -> None:
        why = "components of a lost computer that have a higher priority need room"
        if (
            self._suspensions.suspend(failover.suspended, why, now)
            and (not failover.steps or transit(self._live, failover.steps).committed)
            and start_together(self._live, failover.placement, lost)
        ):
            self._limits.reset_backoff()
        else:
            self._limits.start_backoff(now, dict.fromkeys(lost, 1.0))


def plan_failover(
    situation: Situation,
    lost: Collection[str],
    stuck: Collection[str] = (),  # components that cannot move now
) -> FailoverPlan:
    """Return where the components of lost computers can run.

    All run that memory and devices allow: CPU that is short is shared by priority. What
    works moves when only that makes room; else it is moved later, if that is worth it.
    """
    allowed = allowed_computers(situation.robot)
    pinned = pinned_components(situation.robot)
    missing: dict[str, str] = {}
    homes: dict[str, tuple[str, ...]] = {}
    works = {n: at for n, at in situation.placement.items() if at not in lost}
    for name in situation.placement:
        choices = tuple(sorted(allowed[name] - set(lost) - situation.away))
        if name in works:
            stays = name in pinned or name in stuck or works[name] not in choices
            homes[name] = (works[name],) if stays else choices
        elif name in pinned:
            missing[name] = pinned[name]
        elif not choices:
            here = " or ".join(sorted(allowed[name]))
            missing[name] = f"it may run on {here} only"
        else:
            homes[name] = choices
    stranded = [name for name in homes if name not in works]
    if not stranded:
        return FailoverPlan(placement={}, missing=missing)
    result = placed_beside(situation, homes)
    if result.feasible:
        where = {name: result.placement[name] for name in stranded}
        has_room = plan.evaluate(result.problem, {**works, **where}).feasible
        then = works if has_room else {name: result.placement[name] for name in works}
        # no way leads over what is lost, or there is none
        with contextlib.suppress(RobotError):
            reached = situation.of_running_components()
            now = {n: at for n, at in works.items() if n in reached.placement}
            then = {n: then[n] for n in now}
            steps = plan_transition(reached.robot, now, then, shares_cpu=True)
            return FailoverPlan(placement=where, missing=missing, steps=steps)
    kept = {name: (at,) for name, at in works.items()}
    wanted = {name: homes[name] for name in stranded}
    return _by_priority(situation, kept, wanted, missing)


def _by_priority(
    situation: Situation, kept: Homes, stranded: Homes, missing: Mapping[str, str]
) -> FailoverPlan:
    """Return what fits of the stranded; what runs gives way to higher priorities."""
    placement: dict[str, str] = {}
    suspended: tuple[str, ...] = ()
    missing = dict(missing)
    for architecture in sorted(
        situation.robot.architectures, key=lambda a: -a.priority
    ):
        names = [c.name for c in architecture.components if c.name in stranded]
        if not names or architecture.name in suspended:
            continue
        wanted = {name: stranded[name] for name in names}
        for lower in _more_and_more(situation, architecture.priority, kept):
            gone = {c.name for a in lower for c in a.components}
            left = {name: at for name, at in kept.items() if name not in gone}
            result = placed_beside(situation, {**left, **wanted})
            if result.feasible:
                where = {name: result.placement[name] for name in names}
                placement |= where
                kept = {**left, **{name: (at,) for name, at in where.items()}}
                suspended += tuple(a.name for a in lower)
                break
        else:
            explain(result)
            why = f"it fits nowhere beside the running components: {result.reason}"
            missing |= dict.fromkeys(names, why)
    return FailoverPlan(placement=placement, missing=missing, suspended=suspended)


def _more_and_more(
    situation: Situation, priority: int, kept: Homes
) -> Iterator[tuple[Architecture, ...]]:
    """Yield which of the running architectures of less priority make room."""
    lower = sorted(
        (
            a
            for a in situation.robot.architectures
            if a.layer == "sequencing"
            and a.priority < priority
            and any(c.name in kept for c in a.components)
        ),
        key=lambda a: a.priority,
    )
    for number in range(len(lower) + 1):
        yield tuple(lower[:number])


_THINK_EVERY = 0.5
"""While a change is not worth its cost yet, it is thought about so often [s]."""


class Transitions:
    """The transitions that the loop made, and what limits the next one."""

    def __init__(
        self,
        live: LiveRobot,
        policies: Policies,
        suspensions: Suspensions,
        clock: Callable[[], float],  # the one of situations [s]
    ) -> None:
        self.live = live
        self.limits = MoveLimits()
        self.downtimes: dict[str, float] = {}  # of the last move of each component [s]
        self.loss = LossSuffered()
        self.policies = policies
        self._suspensions = suspensions
        self._clock = clock

    def carry_out(self, steps: tuple[TransitionStep, ...]) -> TransitionReport:
        """Take the steps, and remember that: it may take longer than to settle."""
        try:
            report = transit(self.live, steps)
        finally:
            self.limits.note(steps, self._clock())
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
        self.policies.note_acted(due, now)
        try:
            report = self.carry_out(proposal.steps if proposal else ())
        finally:
            self.loss.note_change(decision.undone, decision.gain, self._clock())
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
        self._urgent: dict[str, tuple[float, float]] = {}
        """Component -> how urgent it was on a crowded computer, and when last [s]."""

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return the transition to a better placement, if that is worth it."""
        transitions, now = self._transitions, situation.now
        limits, loss = transitions.limits, transitions.loss
        bad = situation.about("replan")
        said = self._said
        self._said = {s.key: said.get(s.key, "") for s in situation.symptoms}
        if not bad:
            limits.reset_backoff()
            loss.end(now)
            return None
        links = (s.values.name for s in bad if s.policy.for_each == "link")
        steady = replace(situation, bad_links=frozenset(links))
        situation = with_bursts(steady)
        due = transitions.policies.due(bad, now)
        if (
            not due
            or now < self._think_at
            or limits.is_backing_off(now, situation.amounts())
        ):
            return None
        since = transitions.policies.since
        began = min(since.get(symptom.key, now) for symptom in bad)
        horizon = max(HORIZON, loss.lasts(began, now))
        steady = replace(steady, urgency=self._urgency(situation))
        decision = decide(steady, horizon=horizon, doubt=loss.doubt)
        loss.judge(decision.undone, now)
        loss.note(decision.gain if decision.acts else 0.0, began, now)
        why_not = transitions.why_not(decision, now)
        if not why_not:
            earned_at = loss.earned_at(loss.doubt * decision.cost, now)
            if earned_at <= now:
                return transitions.change(decision, due, situation)
            self._think_at = min(earned_at, now + _THINK_EVERY)
            return None
        limits.start_backoff(now, situation.amounts())
        self._say_why_not(why_not, decision, situation)
        return None

    def _urgency(self, situation: Situation) -> dict[str, float]:
        """Return what is urgent, or was lately: it would be so again where it was."""
        now = situation.now
        for name, factor in urgent(situation.of_running_components()).items():
            before, _ = self._urgent.get(name, (factor, now))
            self._urgent[name] = max(before, factor), now
        self._urgent = {
            n: known for n, known in self._urgent.items() if now - known[1] < STAY_AWAY
        }
        return {name: factor for name, (factor, _) in self._urgent.items()}

    def _say_why_not(self, why: str, decision: Decision, situation: Situation) -> None:
        """Journal why nothing is done, once for each reason while symptoms last."""
        if any(said != why for said in self._said.values()):
            self._said = dict.fromkeys(self._said, why)
            others = alternatives(situation)
            note = self._transitions.live.journal.note
            note("seen", why, decision=decision, alternatives=others)


class UseAgainResponder:
    """Thinks once about each computer that is back for a while, if all is well."""

    purpose = "use computers that are back"

    def __init__(self, transitions: Transitions) -> None:
        self._transitions = transitions
        self._lost: frozenset[str] = frozenset()
        self._back: dict[str, float] = {}

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return a transition that uses what is back, if that is worth it."""
        limits, now = self._transitions.limits, situation.now
        gone = situation.lost | situation.away
        self._back |= dict.fromkeys(sorted(self._lost - gone), now)
        self._lost = situation.lost | self._lost & gone
        back = [
            name
            for name, at in self._back.items()
            if now - at >= CALM and name not in gone
        ]
        if not back or situation.about("replan") or limits.is_backing_off(now):
            return None
        for name in back:
            del self._back[name]
        decision = decide(situation)
        why_not = self._transitions.why_not(decision, now)
        why = "every running component has the CPU that it needs"
        if decision.acts or decision.proposal is not None:
            why = decision.why
        names = " and ".join(f"'{name}'" for name in back)
        note = self._transitions.live.journal.note
        note("seen", f"{names} may be used again; {why}")
        if not decision.acts or why_not:
            return None
        return self._transitions.change(decision, (), situation)
