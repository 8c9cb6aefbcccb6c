"""Watches new code for a while, and lets the code before come back when it fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import ceil

from msgspec import Struct, structs

from poise.clock import wall_time
from poise.errors import RunError
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.move import plan_return
from poise.manage.migration.transition_run import start_together
from poise.manage.observe.chains import is_late
from poise.manage.observe.deviations import Deviation

_SEVERAL = 3
"""New code fails by as many missed deadlines: a first one may be late by the move."""
SHOWN_FOR = 60.0
"""The status shows for this time that code came back [s]."""


class _Trial(Struct, frozen=True, kw_only=True):
    before: Incarnation  # What comes back
    new: Incarnation
    misses: Mapping[str, float]  # Timer -> share of deadlines that were missed before
    restarts: int  # Of its container, before it came
    seconds: float
    until: float


class Canaries:
    """The components whose new code is watched; for the manager's thread."""

    def __init__(self, live: LiveRobot) -> None:
        self._live = live
        self._trials: dict[str, _Trial] = {}
        self._returned: dict[str, tuple[Deviation, float]] = {}

    def begin(
        self, component: str, seconds: float, migrate: Callable[[], MigrationReport]
    ) -> MigrationReport:
        """Replace a component, and watch it from then on if it was replaced."""
        live, before = self._live, self._live.placed.get(component)
        if before is None:  # it was stopped meanwhile: the migration says so
            return migrate()
        found = live.reported(before)
        timers = found.timers if found is not None else ()
        misses = {t.name: t.missed / max(1, t.releases) for t in timers}
        report = migrate()
        if report.committed:
            new = live.placed[component]
            health = live.health_of(new)
            self._trials[component] = _Trial(
                before=before,
                new=new,
                misses=misses,
                restarts=health.restarts if health else 0,
                seconds=seconds,
                until=live.clock.now() + seconds,
            )
            self._returned.pop(component, None)
            what = f"new code of component '{component}' is watched for {seconds:g} s"
            live.journal.note("decided", what)
        return report

    def check(self) -> bool:
        """End what was watched long enough, and what has failed; return whether any.

        A trial starts over when its component starts on another computer, and once its
        computer is reached again.
        """
        now, unheard = self._live.clock.now(), self._live.agents.out_of_reach()
        for component, trial in list(self._trials.items()):
            placed = self._live.placed.get(component)
            if placed is None or _code_of(placed) != _code_of(trial.new):
                del self._trials[component]  # it was replaced again, or stopped
                continue
            if placed.key != trial.new.key or placed.computer in unheard:
                self._trials[component] = self._anew(trial, placed)
            elif why := self._failure(trial, placed):
                del self._trials[component]
                self._return(trial, placed, why)
                return True
            elif now >= trial.until:
                del self._trials[component]
                what = f"new code of component '{component}' has worked for "
                self._live.journal.note("done", f"{what}{trial.seconds:g} s: it stays")
        return False

    def under_way(self) -> tuple[str, ...]:
        """Return what is watched, in words; from any thread."""
        now = self._live.clock.now()
        return tuple(
            f"new code of component '{name}' is watched for "
            f"{max(1, ceil(trial.until - now))} s more"
            for name, trial in self._trials.copy().items()
        )

    def deviations(self) -> Iterator[Deviation]:
        """Yield which code came back lately; from any thread."""
        now = self._live.clock.now()
        for deviation, until in self._returned.copy().values():
            if now < until:
                yield deviation

    def _anew(self, trial: _Trial, placed: Incarnation) -> _Trial:
        """Return a trial that begins now, where its component is placed."""
        until = self._live.clock.now() + trial.seconds
        has_moved = placed.key != trial.new.key
        health = self._live.health_of(placed) if has_moved else None
        if health is None:
            return structs.replace(trial, until=until)
        # what its container did before says nothing of it
        return structs.replace(trial, new=placed, restarts=health.restarts, until=until)

    def _failure(self, trial: _Trial, placed: Incarnation) -> str:
        """Return why new code has failed; empty: it has not."""
        health = self._live.health_of(placed)
        if health is not None and health.restarts > trial.restarts:
            fault = health.last_fault
            return f"its container crashed: {fault.message if fault else 'unknown'}"
        if health is not None and health.state not in {"starting", "running"}:
            return f"its container is {health.state}"
        found = self._live.reported(placed)
        if found is not None and found.state == "failed":
            return f"it failed: {found.error}"
        for timer in found.timers if found is not None else ():
            before, times = trial.misses.get(timer.name, 0.0), timer.releases
            is_worse = timer.missed > max(_SEVERAL - 1, before * times)
            if is_worse and is_late(times, timer.missed):
                return (
                    f"timer '{timer.name}' missed {timer.missed} of {times} deadlines, "
                    f"and {before:.0%} before"
                )
        return ""

    def _return(self, trial: _Trial, placed: Incarnation, why: str) -> None:
        """Let the code before take over; what cannot give its state is restarted."""
        live, name = self._live, placed.component
        what = f"component '{name}' returns to its previous code: {why}"
        live.journal.note("decided", what)
        found = live.reported(placed)
        is_there = found is not None and found.state == "active"
        try:
            is_back = is_there and plan_return(live, trial.before).run().committed
        except RunError as error:  # also once it is back, if no agent can be told
            is_back, what = True, f"{what}; {error}"
            live.journal.note("failed", what)
        where, before = {name: placed.computer}, {name: trial.before}
        if not is_back and not start_together(live, where, instead=before):
            what = f"the new code of component '{name}' has failed ({why}), and its "
            what += "previous code did not start"
            live.journal.note("failed", what)
        shown = Deviation(
            what=what, computer=placed.computer, component=name, since=wall_time()
        )
        self._returned[name] = shown, live.clock.now() + SHOWN_FOR


def _code_of(incarnation: Incarnation) -> tuple[str, str]:
    return incarnation.implementation, incarnation.code
