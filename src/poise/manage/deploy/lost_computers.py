"""Computers whose agents do not obey: out of reach, restarted, or another manager's."""

from __future__ import annotations

import contextlib

from msgspec import Struct

from poise.clock import wall_time
from poise.errors import RunError
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.observe.deviations import Deviation
from poise.units import counted
from poise.wire.records.status_records import AgentStatus

_MOMENT = 1.0
"""A command waits so long for a computer that has just been cut off [s]."""
_REPLACED = 10.0
"""The next agent of a computer is there within this time after one has left [s]."""


class _Loss(Struct):
    at: float  # [s since 1970]
    moment: float  # by the robot's clock [s]
    placed: tuple[tuple[str, int], ...] = ()  # the incarnations that were there
    cause: str = ""  # in words, as far as it was known
    was_cut_off: bool = False  # whether its lease has ended since


class LostComputers:
    """The computers of a running robot that do not obey its manager."""

    def __init__(self, live: LiveRobot) -> None:
        self._live = live
        self._lost = {
            computer.name: _Loss(wall_time(), live.clock.now())
            for computer in live.robot.computers
            if computer.name not in live.computers()
        }
        self._begin_again: dict[tuple[str, int], str] = {}
        """What was placed on a computer whose agent has been restarted since."""
        self._refused: dict[str, Deviation] = {}
        self._starts = _starts(live)
        self._began = wall_time()

    def note(self) -> None:
        """Journal which computers were lost, which are back, and which refuse."""
        live, starts = self._live, _starts(self._live)
        obeying = set(filter(live.agents.obey, live.computers()))
        for name in sorted({c.name for c in live.robot.computers} - self._lost.keys()):
            # an agent that was restarted at once obeys whom the one before it obeyed
            if name not in obeying or starts.get(name) != self._starts.get(name):
                self._note_lost(name)
        for computer, loss in sorted(self._lost.items()):
            if computer not in obeying:
                loss.was_cut_off |= live.agents.heartbeats.is_cut_off(computer)
                continue
            status = live.agents.statuses().get(computer)
            if status is not None and live.reconciler.is_current(computer, status):
                self._note_back(computer, status)
        if self._lost:
            self._note_causes()
        self._note_refusals()
        if self._begin_again:
            self._note_lost_states()

    def away(self) -> frozenset[str]:
        """Return those that do not obey, or have not done what they were told since."""
        return frozenset(self._lost)

    def computers(self) -> frozenset[str]:
        """Return those that nobody hears: what ran there may be started elsewhere.

        Their leases have ended, or end within a second. What an agent has left for the
        next one stays for a while.
        """
        agents = self._live.agents
        away = self._lost.keys() & agents.out_of_reach().keys() & self._live.claimed
        return frozenset(
            name
            for name in sorted(away)
            if not agents.heartbeats.heard_by(name)
            and not agents.heartbeats.is_heard(name)
            and agents.ends_soon(name)
            and not self._is_replaced(name)
        )

    def _is_replaced(self, computer: str) -> bool:
        """Return whether the next agent of a computer is awaited."""
        live, status = self._live, self._live.agents.statuses().get(computer)
        since = live.clock.now() - self._lost[computer].moment
        return status is not None and status.is_leaving and since < _REPLACED

    def deviations(self) -> list[Deviation]:
        """Return what is known of each; from any thread."""
        since = self._live.agents.out_of_reach()
        lost_at = {name: loss.at for name, loss in self._lost.copy().items()}
        refused = self._refused.copy()
        reported, now = self._live.agents.statuses(), wall_time()
        for computer in self._live.robot.computers:
            if computer.name not in reported:
                lost_at.setdefault(computer.name, now)
        returning = [
            Deviation(
                what=f"computer '{computer}' is back, but not yet managed again",
                computer=computer,
                since=lost_at[computer],
            )
            for computer in sorted(lost_at.keys() - refused.keys() - since.keys())
        ]
        away = [
            Deviation(what=what, computer=computer, since=since[computer])
            for computer, what in self._live.unreached().items()
            if computer in since
        ]
        return [*returning, *refused.values(), *away, *self._held_components()]

    def _held_components(self) -> list[Deviation]:
        """Return what may run on computers that were not claimed yet."""
        live, desired = self._live, self._live.desired
        return [
            Deviation(
                what=live.why_held(name),
                computer=desired.placed[name].computer,
                component=name,
                since=self._began,
            )
            for name in sorted(desired.held & desired.placed.keys())
        ]

    def settle(self) -> None:
        """Wait for computers that were cut off for a moment: a command is to come."""
        live, now = self._live, self._live.clock.now()
        self.note()
        lost = {n for n, loss in self._lost.items() if now - loss.moment < _MOMENT}
        if not lost:
            return

        def are_back() -> bool:
            live.check()
            live.reconcile()
            self.note()
            return lost.isdisjoint(self._lost)

        live.agents.wait_news(are_back, _MOMENT)
        back = lost - self._lost.keys()
        here = [
            incarnation
            for incarnation in live.placed.values()
            if incarnation.computer in back
        ]
        with contextlib.suppress(RunError):  # the command itself says so
            live.wait(here, _MOMENT)

    def _note_lost(self, computer: str) -> None:
        live = self._live
        here = (each.key for each in live.placed.values() if each.computer == computer)
        self._lost[computer] = _Loss(wall_time(), live.clock.now(), tuple(here))
        back = f"computer '{computer}' was cut off, or its agent was restarted"
        away = live.unreached().get(computer, back)
        if self._is_replaced(computer):
            away = f"the agent of '{computer}' is being replaced by another one"
        live.journal.note("wrong", away)

    def _note_causes(self) -> None:
        """Journal a computer again once more is known of why it is out of reach."""
        known = self._live.unreached(is_brief=True)
        for computer in sorted(known.keys() & self._lost.keys()):
            loss, why = self._lost[computer], known[computer]
            if loss.cause and len(why) > len(loss.cause):
                self._live.journal.note("wrong", self._live.unreached()[computer])
            loss.cause = max(loss.cause, why, key=len)

    def _note_back(self, computer: str, status: AgentStatus) -> None:
        live = self._live
        loss = self._lost.pop(computer)
        before, self._starts[computer] = self._starts.get(computer), status.start
        what = f"computer '{computer}' is reached again"
        if before is None:
            what = f"computer '{computer}' is reached"
            if any(each.computer == computer for each in live.placed.values()):
                what += "; its components keep running"
        elif before != status.start:
            self._begin_again |= dict.fromkeys(loss.placed, computer)
            what = f"the agent of '{computer}' was restarted"
            if status.took_over is not None:
                num = len(status.took_over)
                went_on = counted(num, "container") if num else "no container"
                what = f"{what}; {went_on} went on"
        elif loss.was_cut_off:
            what += "; its movable components were inactive meanwhile"
        live.journal.note("right", what)

    def _note_lost_states(self) -> None:
        """Say what has begun again without its state: its process had ended, too."""
        live = self._live
        placed = {each.key: each for each in live.placed.values()}
        for key, computer in list(self._begin_again.items()):
            component = live.reported(placed[key]) if key in placed else None
            if key not in placed:
                del self._begin_again[key]
            elif component is not None and computer not in self._lost:
                del self._begin_again[key]
                took_over = live.agents.statuses()[computer].took_over
                container = live.layout.container_of(placed[key])
                went_on = took_over is None or container in took_over
                is_kept = live.agents.checkpoints.get(*key) is not None
                if component.has_state and not went_on and not is_kept:
                    what = (
                        f"component '{key[0]}' began again on '{computer}' without the "
                        "state that it had: its process had ended with the agent or "
                        f"the computer; {live.why_no_checkpoint(key[0])}"
                    )
                    live.note_lost_state(key[0], computer, what)

    def _note_refusals(self) -> None:
        """Journal what an agent refuses, or does not answer, when that is new."""
        live, troubles = self._live, self._live.reconciler.troubles()
        for computer in sorted(self._refused.keys() - troubles.keys()):
            del self._refused[computer]
        for computer, why in troubles.items():
            what = f"computer '{computer}' is reached, but: {why}"
            before = self._refused.get(computer)
            if before is None or before.what != what:
                self._refused[computer] = Deviation(
                    what=what, computer=computer, since=wall_time()
                )
                live.journal.note("failed", what)


def _starts(live: LiveRobot) -> dict[str, tuple[int, str]]:
    """Return which start of its agent each computer has."""
    return {name: status.start for name, status in live.agents.statuses().items()}
