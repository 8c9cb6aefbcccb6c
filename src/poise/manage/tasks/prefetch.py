"""Keeps prepared what the next actions are likely to need, while others run."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping

from msgspec import Struct
from msgspec.structs import replace

from poise.errors import last_error
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.transition_plan import residue
from poise.manage.observe.estimates import Load
from poise.manage.tasks.action_placement import LikelyAction
from poise.manage.tasks.switch import drop, prepare
from poise.manage.tasks.task_reports import PrefetchReport
from poise.model.hardware import fits
from poise.model.robot import ComponentEntry, Robot
from poise.units import format_amount

LEAST_CPU = 0.01
"""Nothing begins to be prepared where less CPU is left for it [cores]."""


class PrefetchPlan(Struct, frozen=True, kw_only=True):
    """What is to be prepared."""

    # component -> computer; what the likeliest action needs comes first
    placement: Mapping[str, str]
    why_not: Mapping[str, str]  # action of a task -> why nothing is, for it


def choose(
    robot: Robot,
    running: Mapping[str, str],
    likely: Iterable[LikelyAction],
    *,
    cpu: Mapping[str, float],  # computer within reach -> CPU to prepare with [cores]
    held: Mapping[str, str],
) -> PrefetchPlan:
    """Return what is to be prepared: of each action that is likely all, or nothing."""
    components = {component.name: component for component in robot.components()}
    left = residue(robot, running)
    for amounts in left.values():
        amounts["memory"] = robot.prefetch.memory * amounts.get("memory", 0.0)
    exclusive = {device.name for device in robot.devices if device.exclusive}
    in_use = exclusive & {d for name in running for d in components[name].devices}
    placement: dict[str, str] = {}
    why_not: dict[str, str] = {}
    idle = [
        LikelyAction(what="", placement={name: at}, probability=0.0)
        for name, at in held.items()
    ]
    for action in [*sorted(likely, key=lambda action: -action.probability), *idle]:
        wanted = {
            name: computer
            for name, computer in action.placement.items()
            if name not in running
            and name not in placement
            and in_use.isdisjoint(components[name].devices)
        }
        new = {computer for n, computer in wanted.items() if held.get(n) != computer}
        why = _without_cpu(new, cpu) or _without_room(wanted, left, components)
        if why:
            if action.what:
                why_not[action.what] = why
            continue
        for name, computer in wanted.items():
            for resource, amount in _held_by(components[name]):
                left[computer][resource] -= amount
        placement |= wanted
    return PrefetchPlan(placement=placement, why_not=why_not)


def _held_by(component: ComponentEntry) -> Iterable[tuple[str, float]]:
    """Return what a component holds that is configured, and does not work."""
    return [(r, amount) for r, amount in component.demand.items() if r != "cpu"]


def _without_cpu(computers: Collection[str], cpu: Mapping[str, float]) -> str:
    for name in sorted(computers):
        if name not in cpu:
            return f"computer '{name}' is out of reach"
        if cpu[name] < LEAST_CPU:
            return f"the running components leave no CPU free on '{name}'"
    return ""


def _without_room(
    wanted: Mapping[str, str],
    left: Mapping[str, Mapping[str, float]],
    components: Mapping[str, ComponentEntry],
) -> str:
    needed: dict[tuple[str, str], float] = defaultdict(float)
    for name, computer in wanted.items():
        for resource, amount in _held_by(components[name]):
            needed[computer, resource] += amount
    for (computer, resource), amount in needed.items():
        room = left[computer].get(resource, 0.0)
        if not fits(amount, room):
            return (
                f"it needs {format_amount(resource, amount)} of {resource} on "
                f"'{computer}', where {format_amount(resource, max(0.0, room))} may be "
                "used for it"
            )
    return ""


LOOK_EVERY = 1.0
"""What is prepared is chosen again so often though nothing is new [s]."""
TRY_AGAIN = 60.0
"""What could not be prepared is tried again after this time [s]."""


class _Preparation(Struct):
    """A component that is prepared, or waits so."""

    incarnation: Incarnation
    restarts: int  # of its container, when it began
    is_ready: bool = False


class Prefetcher:
    """What waits, prepared, for actions that have not begun."""

    def __init__(
        self, live: LiveRobot, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._live = live
        self._clock = clock
        self._chosen_at = float("-inf")
        self._chosen_for: object = None
        self._backed_off: dict[str, float] = {}
        self._why_not: Mapping[str, str] = {}
        self._begun: dict[tuple[str, int], _Preparation] = {}
        self._memory: dict[tuple[str, str], int] = {}
        self._wasted = 0

    def report(self) -> PrefetchReport:
        """Return what it was good for; from any thread."""
        switches = self._live.switches
        return PrefetchReport(
            hit=switches.summary(is_hit=True),
            miss=switches.summary(is_hit=False),
            prepared=self._live.prepared(),
            memory=sum(self._memory.copy().values()),
            wasted=self._wasted,
        )

    def update(
        self, likely: Collection[LikelyAction], loads: Callable[[], Mapping[str, Load]]
    ) -> None:
        """Note how preparations go, and prepare what is likely next."""
        self._note_failures()
        self._note_ready()
        if self._live.robot.prefetch.off:
            likely = ()
        now, placement = self._clock(), self._live.placement()
        chosen_for = [*likely], placement, self._live.computers()
        inputs = *chosen_for, [*self._live.prefetched]
        if inputs == self._chosen_for and now < self._chosen_at + LOOK_EVERY:
            return
        self._chosen_at = now
        off = {name for name, until in self._backed_off.items() if now < until}
        likely = [action for action in likely if off.isdisjoint(action.placement)]
        cpu = self._cpu_left(placement, loads())
        held = self._live.prepared()
        choice = choose(self._live.robot, placement, likely, cpu=cpu, held=held)
        self._go_to(choice, likely, cpu)
        self._chosen_for = *chosen_for, [*self._live.prefetched]

    def _go_to(
        self,
        choice: PrefetchPlan,
        likely: Collection[LikelyAction],
        cpu: Mapping[str, float],
    ) -> None:
        live, note = self._live, self._live.journal.note
        for what, why in choice.why_not.items():
            if what not in self._why_not:
                note("seen", f"nothing is prepared for {what}: {why}")
        self._why_not = choice.why_not
        wanted = choice.placement
        held = live.prepared()
        drops = [name for name in held if wanted.get(name) != held[name]]
        drops += self._make_idle(likely, drops)
        begins = {n: at for n, at in wanted.items() if held.get(n) != at}
        if not drops and not begins:
            return
        if drops:
            note("decided", f"{_list(drops)} no longer kept prepared")
            drop(live, drops)
        for likely_action in likely:
            mine = {
                n: at
                for n, at in begins.items()
                if likely_action.placement.get(n) == at
            }
            if mine:
                text = f"{likely_action.what} is likely next: {_list(mine)} prepared"
                probability = likely_action.probability
                note("decided", text, placement=mine, probability=probability)
        if begins:
            prepare(live, begins, {at: cpu[at] for at in begins.values()})
        restarts = {
            (computer, health.name): health.restarts
            for computer, status in live.agents.statuses().items()
            for health in status.health
        }
        for name in sorted(begins.keys() & live.prefetched.keys()):
            idle = live.prefetched[name]
            before = restarts.get(self._container(idle), 0)
            self._begun.setdefault(idle.key, _Preparation(idle, before))

    def _make_idle(
        self, likely: Iterable[LikelyAction], drops: Collection[str]
    ) -> list[str]:
        """Leave idle what no action is likely to need; return what is not ready."""
        live, unready, ready = self._live, list[str](), list[Incarnation]()
        needed = {name for action in likely for name in action.placement}
        for name, incarnation in live.prefetched.items():
            if not incarnation.gently or name in needed or name in drops:
                continue
            begun = self._begun.get(incarnation.key)
            if begun is not None and begun.is_ready:
                ready.append(replace(incarnation, gently=False))
            else:
                unready.append(name)
        if ready:
            live.commit(
                live.desired.with_prefetched(ready), "prepared components are idle"
            )
        return unready

    def _cpu_left(
        self, placement: Mapping[str, str], loads: Mapping[str, Load]
    ) -> dict[str, float]:
        """Return computer -> CPU that may be used there to prepare [cores]."""
        robot, cpu = self._live.robot, {}
        unplaced = residue(robot, placement)
        for name in self._live.computers():
            left = unplaced[name]["cpu"]
            if name in loads:
                left = min(left, loads[name].capacity - loads[name].used)
            speed = max(1.0, robot.computer(name).speed)
            cpu[name] = max(0.0, robot.prefetch.cpu * left / speed)
        return cpu

    def _note_failures(self) -> None:
        """Drop what cannot be prepared, and say why: its action may still begin."""
        live = self._live
        failed = {
            name: why
            for name, idle in live.prefetched.items()
            if (begun := self._begun.get(idle.key)) and (why := self._failure(begun))
        }
        for name, why in failed.items():
            computer = live.prefetched[name].computer
            where = f"component '{name}' cannot be prepared on '{computer}'"
            text = f"{where}; it starts only with its action: {why}"
            live.journal.note("failed", text)
        if failed:
            self._backed_off |= dict.fromkeys(failed, self._clock() + TRY_AGAIN)
            drop(live, failed)

    def _note_ready(self) -> None:
        """Journal what is ready now, and count what was dropped that never worked."""
        live = self._live
        if not self._begun and not live.prefetched:
            self._memory = {}
            return
        idle = {each.key: each for each in live.prefetched.values()}
        here = idle | {each.key: each for each in live.placed.values()}
        gone = {
            self._container(begun.incarnation)
            for key, begun in self._begun.items()
            if key not in here
        } - {*map(self._container, here.values())}
        self._wasted += sum(self._memory.get(container, 0) for container in gone)
        self._begun = {key: begun for key, begun in self._begun.items() if key in idle}
        self._memory = {
            self._container(each): health.memory
            for each in idle.values()
            if (health := live.health_of(each))
        }
        ready = [
            component
            for component in components_of(live.current())
            if component.state == "inactive"
            and (begun := self._begun.get(component.key))
            and not begun.is_ready
        ]
        for component in ready:
            self._begun[component.key].is_ready = True
        if ready:
            seconds = max(component.start for component in ready)
            names = _list([component.name for component in ready])
            live.journal.note("done", f"{names} prepared within {seconds:.2f} s")

    def _failure(self, begun: _Preparation) -> str:
        """Return why something that is prepared fails; empty: it does not."""
        idle = begun.incarnation
        health = self._live.health_of(idle)
        if health is not None and (
            health.state == "restarting" or health.restarts > begun.restarts
        ):
            return health.last_fault.message if health.last_fault else "it ended"
        component = self._live.reported(idle)
        if component is None or component.state != "failed":
            return ""
        return last_error(component.error) or "it failed"

    def _container(self, incarnation: Incarnation) -> tuple[str, str]:
        return incarnation.computer, self._live.layout.container_of(incarnation)


def _list(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)
