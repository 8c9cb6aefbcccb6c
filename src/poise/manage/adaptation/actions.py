"""What policies do about one subject, beside computing a new placement.

None breaks a pin, a layer or a limit of a computer, moves more than the budget, or goes
back too soon, unless its policy says `force`; nothing at all moves what may not run
there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial

from poise.errors import PoiseError, RunError, UsageError
from poise.manage.adaptation.bad_links import check_links
from poise.manage.adaptation.move_forecast import check_move
from poise.manage.adaptation.responder import Change, MoveLimits
from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.migration_report import (
    MigrationReport,
    TransitionReport,
    TransitionStep,
)
from poise.manage.migration.move import move
from poise.manage.migration.replacement import replace_architecture
from poise.manage.migration.transition_run import transit
from poise.manage.policy.evaluation import Policies, Symptom
from poise.manage.shortages.crash_loops import CrashLoops, components_in
from poise.manage.shortages.suspension import PutAside
from poise.model.policy.policy import Do
from poise.model.robot import Architecture


class Actions:
    """Carries out actions on a running robot, one about one subject at a time.

    `take` raises PoiseError when an action is refused or fails.
    """

    purpose = "carry out policies"

    def __init__(
        self,
        run: RunningComponents,
        put_aside: PutAside,
        limits: MoveLimits,
        policies: Policies,
    ) -> None:
        self._run = run
        self._policies = policies
        self._put_aside = put_aside
        self._limits = limits
        self._by_name: Mapping[Do, Callable[[Symptom, Situation, float], None]] = {
            "move": self._move,
            "replace": self._replace,
            "restart": self._restart,
            "restart elsewhere": CrashLoops(run, put_aside, limits).restart_elsewhere,
            "put aside": self._put,
        }

    def respond(self, situation: Situation, _desired: Desired) -> Change | None:
        """Return the action that is due, the first one if there are more."""
        due = self._policies.due(situation.symptoms, situation.now)
        symptom = next((s for s in due if s.policy.do in self._by_name), None)
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
            self.take(symptom, situation, situation.now)
        except PoiseError as error:
            self._run.journal.note("failed", f"{what}: {error}")

    def take(self, symptom: Symptom, situation: Situation, now: float) -> None:
        """Carry out the action of a symptom's policy."""
        do = symptom.policy.do
        assert do is not None  # noqa: S101, `respond` looked
        self._by_name[do](symptom, situation, now)

    def _move(self, symptom: Symptom, situation: Situation, now: float) -> None:
        policy, run = symptom.policy, self._run
        component, target = _component(symptom), policy.to or ""
        source = situation.placement.get(component, "")
        if source == target:
            return
        check_links(situation, component, target)
        if not policy.force:
            if not self._limits.may_move(1, now):
                raise RunError("the move is over the budget of a minute")
            if target in self._limits.barred(now).get(component, ()):
                raise RunError(f"'{component}' left '{target}' only lately")
            check_move(situation, component, target)
        self._limits.note([TransitionStep(component, source, target)], now)
        _raise_on_failure(move(run, component, target))

    def _replace(self, symptom: Symptom, _situation: Situation, _now: float) -> None:
        policy, run = symptom.policy, self._run
        old = self._architecture(symptom)
        others = [
            a.name
            for a in sorted(run.robot.architectures, key=lambda a: -a.quality)
            if a.function == old.function and a.name != old.name
        ]
        if not (by := policy.by or next(iter(others), "")):
            raise UsageError(f"architecture '{old.name}' has no alternative")
        report = replace_architecture(run, old.name, by, fresh=policy.force)
        _raise_on_failure(report)

    def _restart(self, symptom: Symptom, situation: Situation, _now: float) -> None:
        run = self._run
        if symptom.policy.for_each == "container":
            components = components_in(run, symptom)
        else:
            components = [_component(symptom)]
        steps = []
        for name in sorted(components):
            at = situation.placement[name]
            steps += [TransitionStep(name, at), TransitionStep(name, target=at)]
        _raise_on_failure(transit(run, tuple(steps)))

    def _put(self, symptom: Symptom, situation: Situation, now: float) -> None:
        if symptom.policy.for_each == "computer":
            architecture = _lowest(situation, symptom.computer)
        else:
            architecture = self._architecture(symptom)
        self._put_aside.put([architecture.name], symptom.what, now)

    def _architecture(self, symptom: Symptom) -> Architecture:
        layout, name = self._run.layout, symptom.values.name
        is_container = symptom.policy.for_each == "container"
        for architecture in self._run.robot.architectures:
            for component in architecture.components:
                inside = layout.container_of(component.name) if is_container else ""
                if component.name == _component(symptom) or name == inside:
                    return architecture
        raise UsageError(f"no architecture has '{name}'")


def saw(symptoms: Iterable[Symptom]) -> list[dict[str, object]]:
    """Return policies and the values that they saw, for the journal."""
    return [{"policy": each.policy.name, "saw": each.values} for each in symptoms]


def _raise_on_failure(report: MigrationReport | TransitionReport) -> None:
    if not report.committed:
        raise RunError(report.reason)


def _component(symptom: Symptom) -> str:
    """Return the component that a symptom is about: its own, or that of a timer."""
    return getattr(symptom.values, "component", symptom.values.name)


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
