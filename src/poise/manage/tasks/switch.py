"""From the components of some actions to those of the next: at work, or prepared.

A prepared component is configured, inactive and joined to nothing. It keeps its state
and uses memory, but no CPU; it becomes active within moments.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Mapping
from math import inf

from msgspec.structs import replace

from poise.clock import boot_time
from poise.errors import RunError, last_error
from poise.manage.agent_connections.statuses import components_of, not_at_goals
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    DoesNotStart,
    LiveRobot,
    NotReady,
)
from poise.manage.observe.deviations import Numbers, last_numbers
from poise.model.robot import Architecture


def prepare(
    live: LiveRobot,
    placement: Mapping[str, str],
    cpu: Mapping[str, float],  # computer -> what others leave for it [cores]
) -> None:
    """Let components be prepared unless they are at work; return before they are."""
    new = [
        _prepared(live, name, computer, gently=True)
        for name, computer in placement.items()
        if name not in live.placed
    ]
    preparation_cpu = {**live.desired.preparation_cpu, **cpu}
    live.commit(
        replace(live.desired, preparation_cpu=preparation_cpu).with_prefetched(new),
        "prepare the next action",
    )


def drop(live: LiveRobot, components: Iterable[str]) -> None:
    """End prepared components; their state is lost."""
    gone = [name for name in components if name in live.prefetched]
    if gone:
        live.commit(live.desired.without(gone), "idle components end")


PATIENCE = 0.5
"""All else waits for so long [s] until what begins is ready; then it goes on."""


LOSS_FIRST = 1.0
"""For so long [s] nothing that takes long begins after a computer was lost: what was
there is started elsewhere first."""


class LaterError(RunError):
    """What was to begin takes long: it is configured while all else goes on."""

    def __init__(self, why: str, delay: float = 0.0) -> None:
        super().__init__(why)
        self.delay = delay


def switch(live: LiveRobot, ends: Collection[str], begins: Mapping[str, str]) -> bool:
    """Let components rest, prepared, and others begin to work.

    Until they rest, what they publish goes out, unless that takes over `PATIENCE`.
    Returns whether all of these were prepared. Raises LaterError when they take long.
    """
    are_ready = _are_ready(live, begins)
    away = live.agents.out_of_reach()
    for name, at in begins.items():
        before = live.prefetched.get(name)
        if before is not None and before.has_worked and before.computer != at:
            why = "not all that is needed now fits where it was idle"
            if before.computer in away:
                why = f"'{before.computer}', where it was idle, is out of reach"
            live.journal.note("decided", f"'{name}' begins anew on '{at}': {why}")
    idle = [
        replace(
            live.placed[name],
            goal="inactive",
            parting=True,
            has_worked=True,
            gently=False,
        )
        for name in ends
    ]
    new = [
        replace(_prepared(live, name, at), unjoined=False, gently=False)
        for name, at in begins.items()
    ]
    desired = live.desired.without([*ends, *begins]).with_prefetched(idle)
    try:
        live.commit(desired.with_coming(new), "switch to the next action")
        _wait_until_configured(live, new)
        if not new:
            live.commit(live.desired.parted(), "what the action needed rests")
            return are_ready
        live.end_left_behind(new)
        # what is at work on a computer that was joined meanwhile goes on
        active = [e.with_goal("active") for e in new if e.component not in live.placed]
        desired = live.desired.parted().with_coming(active)
        live.commit(desired, "activate the next action")
        _wait(live, active, ACTIVE_LIMIT, until_loss=True)
    except LaterError as error:
        later = [replace(each, unjoined=True) for each in new]
        desired = live.desired.parted().with_coming(()).with_configured_ahead(later)
        live.commit(desired, f"all else goes on meanwhile: {error}")
        raise
    except RunError as error:
        desired = live.desired.parted().with_coming(())
        live.commit(desired, f"it cannot begin: {error}")
        raise
    live.commit(live.desired.placing(active), "the next action is at work")
    return are_ready


class SlowStarts:
    """What is configured for actions that are due, while all else goes on."""

    def __init__(self, live: LiveRobot) -> None:
        self._live = live
        self._since: dict[str, float] = {}
        self._not_before = 0.0
        self._faults_before: Numbers = {}

    def note(self, begins: Iterable[str], since: float, delay: float) -> None:
        """Note what takes long, due since then [s, `boot_time`], and its delay [s]."""
        self._since = {**dict.fromkeys(begins, since), **self._since}
        self._not_before = boot_time() + delay
        self._faults_before = last_numbers(self._live.agents.statuses())

    def keep(self, begins: Mapping[str, str]) -> None:
        """End what is not to begin any more, or elsewhere."""
        ahead = self._ahead()
        gone = [e for n, e in ahead.items() if begins.get(n) != e.computer]
        self._since = {n: at for n, at in self._since.items() if n in begins}
        if gone:
            desired = self._live.desired.without_configured_ahead(gone)
            self._live.commit(desired, "it does not begin there any more")

    def since(self, begins: Iterable[str]) -> float:
        """Return since when the actions are due of what begins [s]; inf: it is new."""
        return min((self._since.get(name, inf) for name in begins), default=inf)

    def placement(self) -> dict[str, str]:
        """Return where the components are that take long."""
        return {name: each.computer for name, each in self._ahead().items()}

    def is_due(self) -> bool:
        """Return whether there are some, and all can begin now."""
        ahead = self._ahead() if self._since else {}
        return bool(ahead) and not self._late(ahead)

    def ready(self, begins: Mapping[str, str]) -> dict[str, str]:
        """Return what may begin now, whole architectures; RunError: some never will."""
        live, ahead = self._live, self._ahead()
        _raise_on_failed(live, ahead.values())
        live.raise_on_crashes(ahead.values(), self._faults_before)
        late = self._late(ahead)
        if late and boot_time() > self.since(late) + READY_LIMIT:
            waits = [*live.missing(late.values()), *_not_at_rest(live)]
            raise RunError(f"not ready within {READY_LIMIT:g} s: {'; '.join(waits)}")
        stuck = {live.robot.architecture_of(name).name for name in late}
        return {
            name: at
            for name, at in begins.items()
            if live.robot.architecture_of(name).name not in stuck
        }

    def _ahead(self) -> dict[str, Incarnation]:
        ahead = self._live.desired.configured_ahead
        return {e.component: e for e in ahead if e.component in self._since}

    def _late(self, ahead: Mapping[str, Incarnation]) -> dict[str, Incarnation]:
        live = self._live
        if ahead and (boot_time() < self._not_before or live.coming_to_rest()):
            return dict(ahead)
        return {n: e for n, e in ahead.items() if not _is_inactive(live, e)}


def _are_ready(live: LiveRobot, components: Mapping[str, str]) -> bool:
    """Return whether all of some components are prepared where they are to work."""
    return all(
        (idle := live.prefetched.get(name)) is not None
        and idle.computer == computer
        and _is_inactive(live, idle)
        for name, computer in components.items()
    )


def _is_inactive(live: LiveRobot, incarnation: Incarnation) -> bool:
    found = live.reported(incarnation)
    return found is not None and found.state == "inactive"


def _prepared(
    live: LiveRobot, name: str, computer: str, *, gently: bool = False
) -> Incarnation:
    ahead = {each.component: each for each in live.desired.configured_ahead}
    before = live.prefetched.get(name) or ahead.get(name)
    if before is not None and before.computer == computer:
        found = live.reported(before)
        if found is None or found.state != "failed":
            return before
    new = live.begun(name, computer)
    return replace(new, goal="inactive", gently=gently, unjoined=True)


def _wait(
    live: LiveRobot,
    wanted: Collection[Incarnation],
    limit: float,
    *,
    until_loss: bool = False,  # LaterError: a lost computer is more urgent
) -> None:
    """Wait until components are at their goals; others' troubles do not count."""
    away = live.agents.out_of_reach().keys()

    def trouble() -> bool:
        live.poll()
        _raise_on_failed(live, wanted)
        if until_loss and (lost := live.agents.out_of_reach().keys() - away):
            raise LaterError(f"computer '{min(lost)}' is out of reach", LOSS_FIRST)
        return False

    live.wait(wanted, limit, trouble)


def _wait_until_configured(live: LiveRobot, new: Collection[Incarnation]) -> None:
    """Wait until all is configured, joined or idle; LaterError: `new` takes long."""
    try:
        _wait(live, new, PATIENCE)
    except NotReady as error:
        raise LaterError(str(error)) from error

    def is_at_rest() -> bool:
        live.poll()
        return not live.coming_to_rest()

    if not live.agents.wait_news(is_at_rest, PATIENCE) and new:
        raise LaterError("; ".join(_not_at_rest(live)))


def _raise_on_failed(live: LiveRobot, wanted: Iterable[Incarnation]) -> None:
    mine = {incarnation.key for incarnation in wanted}
    for component in components_of(live.agents.statuses()) if mine else ():
        if component.key in mine and component.state == "failed":
            raise DoesNotStart(component.name, component.error)


def _not_at_rest(live: LiveRobot) -> list[str]:
    """Return what should rest and does not yet, in words."""
    resting, current = live.coming_to_rest(), live.current()
    silent = {each.computer for each in resting} - current.keys()
    known = [each for each in resting if each.computer in current]
    return not_at_goals(known, current, silent)


SHORTEST, LONGEST = 10.0, 300.0
"""An idle component stays for so long at least, and at most [s]."""
_START = 0.3
"""A start takes so long where it was not measured [s]."""


class IdleComponents:
    """The components that are idle after their actions, and since when."""

    def __init__(self, live: LiveRobot) -> None:
        self._live = live
        self._since: dict[str, float] = {}

    def drop_expired(self, kept: Collection[str]) -> None:
        """End what has been idle for too long."""
        live, now = self._live, time.monotonic()
        self._drop_failed()
        idle = {n for n, e in live.prefetched.items() if not e.gently}
        self._since = {n: self._since.get(n, now) for n in sorted(idle)}
        for architecture in live.robot.architectures:
            names = [
                c.name
                for c in architecture.components
                if c.name in self._since and c.name not in kept
            ]
            if not names:
                continue
            limit = self.limit(architecture)
            if all(now - self._since[name] >= limit for name in names):
                text = f"stopping architecture '{architecture.name}': no action has "
                live.journal.note("decided", f"{text}needed it for {limit:.1f} s")
                drop(live, names)

    def _drop_failed(self) -> None:
        """End what failed as it came to rest, and say so: nothing waits for it."""
        live, failed = self._live, []
        for name, idle in live.prefetched.items():
            found = None if idle.gently else live.reported(idle)
            if found is not None and found.state == "failed":
                what = f"component '{name}' on '{idle.computer}' failed when its action"
                why = last_error(found.error)
                live.journal.note("wrong", f"{what} ended, and lost its state: {why}")
                failed.append(name)
        drop(live, failed)

    def oldest_first(self, prepared: Iterable[str]) -> list[str]:
        """Return prepared components: first what only may be needed, last what ends."""
        live, now = self._live, time.monotonic()
        known = {name: self._since.get(name, 0.0) for name in live.prefetched}
        return sorted(prepared, key=lambda name: known.get(name, now))

    def limit(self, architecture: Architecture) -> float:
        """Return for how long an architecture is idle at most [s].

        Until the memory that it holds has cost what its start did: both together cost
        at most twice what they would if the future were known.
        """
        if architecture.linger is not None:
            return architecture.linger
        live = self._live
        names = {c.name for c in architecture.components}
        starts = [c.start for c in components_of(live.current()) if c.name in names]
        start = max(starts, default=0.0) or _START
        capacity = {c.name: c.capacity.get("memory", 0.0) for c in live.robot.computers}
        share = sum(
            c.demand.get("memory", 0.0) / capacity[idle.computer]
            for c in architecture.components
            if (idle := live.prefetched.get(c.name)) and capacity.get(idle.computer)
        )
        return min(LONGEST, max(SHORTEST, start / share)) if share else LONGEST
