"""Actions of policies about one subject; a new placement is computed elsewhere.

No action breaks a pin, a layer or a limit of a computer, moves more than the budget, or
returns too soon, unless its policy says `force`; nothing at all moves a component to a
computer where it may not run. A container in a crash loop is tried once on each
computer, then suspended; what is pinned stays, and its agent keeps restarting it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial

from poise.errors import PoiseError, RunError, UsageError
from poise.manage.adaptation.bad_links import check_links
from poise.manage.adaptation.move_forecast import check_move
from poise.manage.adaptation.policies import Policies, Symptom, saw
from poise.manage.adaptation.situation import Change, Situation
from poise.manage.adaptation.when_to_act import MoveLimits
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.migration_report import (
    MigrationReport,
    TransitionReport,
    TransitionStep,
)
from poise.manage.migration.move import plan_alternative, plan_move
from poise.manage.migration.transition_run import start_together, transit
from poise.manage.shortages.free_room import room_for_components
from poise.manage.shortages.suspension import Suspensions
from poise.model.check.allowed_computers import pinned_components
from poise.model.policy import Do
from poise.model.robot import Architecture, Robot
from poise.units import named


class Actions:
    """Carries out policies' actions; `act` raises PoiseError when one fails."""

    purpose = "carry out policies"

    def __init__(
        self,
        live: LiveRobot,
        suspensions: Suspensions,
        limits: MoveLimits,
        policies: Policies,
    ) -> None:
        self._live = live
        self._policies = policies
        self._suspensions = suspensions
        self._limits = limits
        self._crashed: dict[str, dict[str, float]] = {}
        """Container -> the computers where it crashed again and again, and when [s]."""
        self._by_name: Mapping[Do, Callable[[Symptom, Situation], None]] = {
            "move": self._move,
            "replace": self._replace,
            "restart": self._restart,
            "restart elsewhere": self._restart_elsewhere,
            "suspend": self._suspend,
        }

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return the action that is due, the first one if there are more."""
        due = self._policies.due(situation.symptoms, situation.now)
        symptom = next(
            (
                s
                for s in due
                if s.policy.do in self._by_name and not _is_there(s, situation)
            ),
            None,
        )
        if symptom is None:
            return None
        policy = symptom.policy
        what = f"policy '{policy.name}': {policy.do} '{symptom.values.name}'"
        return Change(
            why=f"{what}: {symptom.what}",
            facts={"policies": saw([symptom])},
            carry_out=partial(self._carry_out, symptom, situation, what),
        )

    def _carry_out(self, symptom: Symptom, situation: Situation, what: str) -> None:
        self._policies.note_acted([symptom], situation.now)
        try:
            self.act(symptom, situation)
        except PoiseError as error:
            self._live.journal.note("failed", f"{what}: {error}")

    def act(self, symptom: Symptom, situation: Situation) -> None:
        """Carry out the action of a symptom's policy."""
        do = symptom.policy.do
        assert do is not None  # noqa: S101, `respond` looked
        self._by_name[do](symptom, situation)

    def _move(self, symptom: Symptom, situation: Situation) -> None:
        policy, live, now = symptom.policy, self._live, situation.now
        component, target = component_of(symptom), policy.to or ""
        source = situation.placement.get(component, "")
        check_links(situation, component, target)
        if not policy.force:
            if not self._limits.may_move(1, now):
                raise RunError("too many moves in the last minute")
            if target in self._limits.quarantined(now).get(component, ()):
                raise RunError(f"'{component}' left '{target}' only recently")
            check_move(situation, component, target)
        self._limits.note([TransitionStep(component, source, target)], now)
        _raise_on_failure(plan_move(live, component, target).run())

    def _replace(self, symptom: Symptom, _situation: Situation) -> None:
        policy, live = symptom.policy, self._live
        old = self._architecture(symptom)
        others = [
            a.name
            for a in sorted(live.robot.architectures, key=lambda a: -a.quality)
            if a.function == old.function and a.name != old.name
        ]
        if not (by := policy.by or next(iter(others), "")):
            raise UsageError(f"architecture '{old.name}' has no alternative")
        replacement = plan_alternative(live, old.name, by, fresh=policy.force)
        _raise_on_failure(replacement.run())

    def _restart(self, symptom: Symptom, situation: Situation) -> None:
        live = self._live
        if symptom.policy.for_each == "container":
            components = _components_in(live, symptom)
        else:
            components = [component_of(symptom)]
        steps = []
        for name in sorted(components):
            if (at := situation.placement.get(name)) is None:
                raise RunError(f"component '{name}' is not at work")
            steps += [TransitionStep(name, at), TransitionStep(name, target=at)]
        _raise_on_failure(transit(live, tuple(steps)))

    def _suspend(self, symptom: Symptom, situation: Situation) -> None:
        if symptom.policy.for_each == "computer":
            architecture = _lowest(situation, symptom.computer)
        else:
            architecture = self._architecture(symptom)
        self._suspensions.suspend([architecture.name], symptom.what, situation.now)

    def _architecture(self, symptom: Symptom) -> Architecture:
        placed, name = self._live.placed, symptom.values.name
        is_container = symptom.policy.for_each == "container"
        for architecture in self._live.robot.architectures:
            for component in architecture.components:
                there = placed.get(component.name) if is_container else None
                inside = there and self._live.layout.container_of(there)
                if component.name == component_of(symptom) or name == inside:
                    return architecture
        raise UsageError(f"no architecture has '{name}'")

    def _restart_elsewhere(self, symptom: Symptom, situation: Situation) -> None:
        """Restart a container where it has not crashed; else suspend it."""
        live, container, now = self._live, symptom.values.name, situation.now
        names = _components_in(live, symptom)
        pinned = _pinned(live.robot)
        if not names:
            raise RunError("nothing in it is at work")
        for name in names:
            if name in pinned:
                stays = f"component '{name}' stays on '{symptom.computer}'"
                goes_on = "its agent keeps restarting it"
                raise RunError(f"{stays}: {pinned[name]}; {goes_on}")
        before = _crashed_before(container, situation)
        before |= self._crashed.get(container, {})
        crashed = {at: when for at, when in before.items() if now - when < FORGET_AFTER}
        crashed[symptom.computer] = now
        self._crashed[container] = crashed
        while where := room_for_components(situation, names, crashed):
            steps = [
                TransitionStep(name, situation.placement[name], at)
                for name, at in where.items()
            ]
            self._limits.note(steps, now)
            if start_together(live, where, situation.lost):
                return
            if lost := set(where.values()) - live.computers():
                away = named("computer", sorted(lost))
                raise RunError(f"{away} went out of reach in the meantime")
            crashed |= dict.fromkeys(where.values(), now)
        del self._crashed[container]
        self._suspend_crashed(names[0], symptom, situation, crashed)

    def _suspend_crashed(
        self,
        component: str,
        symptom: Symptom,
        situation: Situation,
        crashed: Iterable[str],
    ) -> None:
        """Suspend an architecture for good, and say what happened and the way out."""
        computers = " and ".join(f"'{computer}'" for computer in sorted(crashed))
        container = symptom.values.name
        health = situation.statuses[symptom.computer].health
        here = next((h for h in health if h.name == container), None)
        if here and here.state == "restarting" and here.reason:
            # what its computer lacks may be there again at any moment
            raise RunError("no other computer has room for it; its agent keeps trying")
        fault = here.last_fault if here else None
        way_out = "it is resumed when its code changes, or by `poise balance`"
        said = f" (the last time: {fault.message})" if fault else ""
        why = f"container '{container}' crashes again and again on {computers}{said}"
        architecture = self._live.robot.architecture_of(component)
        self._suspensions.quarantine(architecture.name)
        is_there = any(c.name in self._live.placed for c in architecture.components)
        # else the last try to start it ended so
        put = (
            self._suspensions.suspend if is_there else self._suspensions.note_suspended
        )
        put([architecture.name], f"{why}; {way_out}", situation.now)


CRASHES = 5
"""So many faults are a crash loop, as the policy says."""
FORGET_AFTER = 600.0
"""A container that has not crashed for so long [s] may return where it did."""


def _raise_on_failure(report: MigrationReport | TransitionReport) -> None:
    if not report.committed:
        raise RunError(report.reason)


def component_of(symptom: Symptom) -> str:
    """Return the component that a symptom is about: its own, or that of a timer."""
    return getattr(symptom.values, "component", symptom.values.name)


def _is_there(symptom: Symptom, situation: Situation) -> bool:
    """Return whether a component to be moved is where it should be."""
    where = situation.placement.get(component_of(symptom))
    return symptom.policy.do == "move" and where == symptom.policy.to


def _lowest(situation: Situation, computer: str) -> Architecture:
    """Return the lowest architecture on a computer, if another one is higher."""
    here = [
        a
        for a in situation.robot.architectures
        if any(situation.placement.get(c.name) == computer for c in a.components)
    ]
    lowest = min(
        (a for a in here if a.layer == "sequencing"),
        key=lambda a: a.priority,
        default=None,
    )
    if lowest is None or lowest.priority == max(a.priority for a in here):
        raise RunError(f"no architecture on '{computer}' has a lower priority")
    return lowest


def _crashed_before(container: str, situation: Situation) -> dict[str, float]:
    """Return where agents saw it crash as often, under an earlier manager, and when."""
    crashed = {}
    for computer, status in situation.statuses.items():
        ages = [
            status.uptime - fault.uptime
            for fault in status.faults
            if fault.container == container and not fault.is_over
        ]
        if sum(age < FORGET_AFTER for age in ages) >= CRASHES:
            crashed[computer] = situation.now - max(0.0, ages[-1])
    return crashed


def _components_in(live: LiveRobot, symptom: Symptom) -> list[str]:
    """Return the components in a symptom's container; held ones may work elsewhere."""
    return sorted(
        name
        for name, incarnation in live.placed.items()
        if name not in live.desired.held
        and incarnation.computer == symptom.computer
        and live.layout.container_of(incarnation) == symptom.values.name
    )


def _pinned(robot: Robot) -> dict[str, str]:
    """Return component -> why it stays; not for being on a robot's only computer."""
    is_alone = len(robot.computers) == 1
    free = {
        component.name
        for architecture in robot.architectures
        for component in architecture.components
        if is_alone and architecture.layer == "sequencing" and component.movable
    }
    pinned = pinned_components(robot)
    return {name: why for name, why in pinned.items() if name not in free}
