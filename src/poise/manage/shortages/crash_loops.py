"""Containers that crash again and again: restarted elsewhere, at last put aside.

Each computer is tried once. What is pinned stays, and its agent goes on restarting it.
"""

from __future__ import annotations

from poise.errors import RunError
from poise.manage.adaptation.responder import MoveLimits
from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.migration.migration_report import TransitionStep
from poise.manage.migration.transition_run import start_together
from poise.manage.policy.evaluation import Symptom
from poise.manage.shortages.free_room import room_for_components
from poise.manage.shortages.suspension import PutAside
from poise.model.check.allowed_computers import pinned_components
from poise.model.robot import Robot

CRASHES = 5
"""So many faults are a crash loop, as the policy says."""
FORGET_AFTER = 600.0
"""A container that has not crashed for so long [s] may return where it did."""


class CrashLoops:
    """Where containers crashed again and again, and what is done about it."""

    def __init__(
        self, run: RunningComponents, put_aside: PutAside, limits: MoveLimits
    ) -> None:
        self._run = run
        self._put_aside = put_aside
        self._limits = limits
        self._crashed: dict[str, dict[str, float]] = {}

    def restart_elsewhere(
        self, symptom: Symptom, situation: Situation, now: float
    ) -> None:
        """Restart a container where it has not crashed; else put it aside."""
        run, container = self._run, symptom.values.name
        names = components_in(run, symptom)
        pinned = _pinned(run.robot)
        if not names:
            raise RunError("it is not there any more")
        for name in names:
            if name in pinned:
                stays = f"component '{name}' stays on '{symptom.computer}'"
                goes_on = "its agent goes on restarting it"
                raise RunError(f"{stays}: {pinned[name]}; {goes_on}")
        before = _crashed_before(container, situation, now) | self._crashed.get(
            container, {}
        )
        crashed = {at: when for at, when in before.items() if now - when < FORGET_AFTER}
        crashed[symptom.computer] = now
        self._crashed[container] = crashed
        while where := room_for_components(situation, names, crashed):
            steps = [
                TransitionStep(name, situation.placement[name], at)
                for name, at in where.items()
            ]
            self._limits.note(steps, now)
            if start_together(run, where, situation.lost):
                return
            if lost := set(where.values()) - run.computers():
                away = " and ".join(f"'{name}'" for name in sorted(lost))
                raise RunError(f"{away} is out of reach meanwhile")
            crashed |= dict.fromkeys(where.values(), now)
        del self._crashed[container]
        self._put(names, symptom, situation, sorted(crashed), now)

    def _put(
        self,
        names: list[str],
        symptom: Symptom,
        situation: Situation,
        crashed: list[str],
        now: float,
    ) -> None:
        """Put an architecture aside for good, and say what happened and the way out."""
        computers = " and ".join(f"'{computer}'" for computer in crashed)
        container = symptom.values.name
        health = situation.statuses[symptom.computer].health
        fault = next((h.last_fault for h in health if h.name == container), None)
        way_out = "it is taken back when its code has changed, or by `poise balance`"
        said = f" (the last time: {fault.message})" if fault else ""
        why = f"container '{container}' crashes again and again on {computers}{said}"
        architecture = self._run.robot.architecture_of(names[0])
        self._put_aside.bar(architecture.name)
        is_there = any(c.name in self._run.placed for c in architecture.components)
        # else the last try to start it ended so
        put = self._put_aside.put if is_there else self._put_aside.note
        put([architecture.name], f"{why}; {way_out}", now)


def _crashed_before(
    container: str, situation: Situation, now: float
) -> dict[str, float]:
    """Return where agents saw it crash as often, under an earlier manager, and when."""
    found = {}
    for computer, status in situation.statuses.items():
        ages = [
            status.uptime - fault.uptime
            for fault in status.faults
            if fault.container == container and not fault.is_over
        ]
        if sum(age < FORGET_AFTER for age in ages) >= CRASHES:
            found[computer] = now - max(0.0, ages[-1])
    return found


def components_in(run: RunningComponents, symptom: Symptom) -> list[str]:
    """Return the components of the container that a symptom is about."""
    return sorted(
        name
        for name, each in run.placed.items()
        if each.computer == symptom.computer
        and run.layout.container_of(name) == symptom.values.name
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
