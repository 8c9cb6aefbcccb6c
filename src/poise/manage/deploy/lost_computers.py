"""Computers that are out of reach, or whose agents were restarted; brings them back."""

from __future__ import annotations

import contextlib
import time

from poise.errors import RunError
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.observe.deviations import Deviation
from poise.units import counted

_MOMENT = 1.0
"""A command waits so long for a computer that has just been cut off [s]."""
_RETRY_AFTER = 1.0
"""A computer that came back, but refuses, is asked again after this time [s]."""


class LostComputers:
    """The computers of a running robot that do not obey its manager."""

    def __init__(self, run: RunningComponents) -> None:
        self._run = run
        self._reached = set(run.computers())
        self._retry_at: dict[str, float] = {}
        self._refusals: dict[str, Deviation] = {}
        self._lost_at: dict[str, float] = {}
        self._pids = _pids(run)

    def note(self) -> None:
        """Journal which computers were lost, and go on without them."""
        run = self._run
        pids = _pids(run)
        obeying = {
            computer
            for computer in run.computers()
            # an agent that was restarted at once obeys whom the one before it obeyed
            if run.agents.obey(computer)
            and pids.get(computer) == self._pids.get(computer)
        }
        for computer in self._reached - obeying:
            self._reached.discard(computer)
            run.excused.add(computer)
            self._lost_at[computer] = time.time()
            back = f"computer '{computer}' was cut off, or its agent was restarted"
            run.journal.note("wrong", run.unreached().get(computer, back))

    def computers(self) -> frozenset[str]:
        """Return those that nobody hears: what ran there may be started elsewhere.

        Their leases have ended, or end within a second.
        """
        agents = self._run.agents
        away = self._run.excused & agents.out_of_reach().keys()
        return frozenset(
            name
            for name in away
            if not agents.heard_by(name) and agents.ends_soon(name)
        )

    def deviations(self) -> list[Deviation]:
        """Return what is known of each; from any thread."""
        since = self._run.agents.out_of_reach()
        refusals = {c: r for c, r in self._refusals.copy().items() if c not in since}
        returning = (
            self._lost_at.keys() - self._reached - refusals.keys() - since.keys()
        )
        found = [
            Deviation(
                what=f"computer '{computer}' is back, but not yet managed again",
                computer=computer,
                since=self._lost_at[computer],
            )
            for computer in sorted(returning)
        ]
        away = [
            Deviation(what=what, computer=computer, since=since[computer])
            for computer, what in self._run.unreached().items()
            if computer in since
        ]
        return [*found, *refusals.values(), *away]

    def bring_back(self) -> None:
        """Let those that returned run what they should run now."""
        run, now = self._run, time.monotonic()
        for computer in run.computers() - self._reached:
            is_there = computer in run.agents.statuses()
            if is_there and self._retry_at.get(computer, 0.0) <= now:
                self._bring_back(computer, now)

    def settle(self) -> None:
        """Wait for computers that were cut off for a moment: a command is to come."""
        run, now = self._run, time.time()
        self.note()
        lost = {n for n, at in self._lost_at.items() if now - at < _MOMENT}
        lost -= self._reached
        if lost:
            run.agents.wait_news(lambda: lost <= run.computers(), _MOMENT)
            self.bring_back()
            back = lost & self._reached
            here = [each for each in run.placed.values() if each.computer in back]
            with contextlib.suppress(RunError):  # the command itself says so
                run.wait(here, _MOMENT)

    def _bring_back(self, computer: str, now: float) -> None:
        run = self._run
        was_cut_off = run.agents.is_cut_off(computer)
        is_same = run.agents.obey(computer) or was_cut_off
        try:
            run.synchronise(computer)
        except RunError as error:
            self._retry_at[computer] = now + _RETRY_AFTER
            what = f"computer '{computer}' is reached again, but: {error}"
            before = self._refusals.get(computer)
            if before is None or before.what != what:
                self._refusals[computer] = Deviation(
                    what=what, computer=computer, since=time.time()
                )
                run.journal.note("failed", what)
            return
        self._refusals.pop(computer, None)
        self._reached.add(computer)
        run.excused.discard(computer)
        status = run.agents.statuses()[computer]
        pid_before, self._pids[computer] = self._pids.get(computer), status.pid
        what = f"computer '{computer}' is reached again"
        if pid_before != status.pid:
            adopted = status.adopted
            went_on = counted(adopted, "container") if adopted else "no container"
            what = f"the agent of '{computer}' was restarted; {went_on} went on"
        elif not is_same:
            what += "; it obeyed another manager meanwhile"
        elif was_cut_off:
            what += "; its movable components were inactive meanwhile"
        run.journal.note("right", what)


def _pids(run: RunningComponents) -> dict[str, int]:
    """Return the processes of the agents, by computer."""
    return {name: each.pid for name, each in run.agents.statuses().items()}
