"""Which manager an agent obeys, and what it does without one."""

from __future__ import annotations

import time
from collections.abc import Callable

from poise.runtime.agent.fence import Fence
from poise.runtime.agent.heartbeat_exchange import HeartbeatExchange
from poise.runtime.agent.supervision.supervisor import Supervisor
from poise.wire.records.requests import ManagerId


class Managed:
    """Says who manages an agent, and makes leased components inactive without a lease.

    Parameters
    ----------
    say
        Called with a sentence when a manager comes or goes.

    Attributes
    ----------
    cut_off
        Since when it is cut off from its manager [s since 1970]; 0: it is not.
    """

    def __init__(
        self,
        fence: Fence,
        supervisor: Supervisor,
        heartbeats: HeartbeatExchange,
        say: Callable[[str], object],
    ) -> None:
        self.cut_off = 0.0
        self._fence = fence
        self._supervisor = supervisor
        self._heartbeats = heartbeats
        self._say = say
        self._manager: ManagerId | None = None

    def look(self) -> None:
        """Take note of managers that came or went, and of the end of the lease."""
        self._note_manager()
        self._note_cut_off()

    def _note_manager(self) -> None:
        before, self._manager = self._manager, self._fence.present_manager()
        if self._manager == before:
            return
        if before is not None:
            self._say(f"{before} is gone; containers go on")
        if self._manager is not None:
            self._say(f"managed by {self._manager}")

    def _note_cut_off(self) -> None:
        """Make leased components inactive once the lease has ended."""
        if self._heartbeats.is_cut_off and not self.cut_off:
            self.cut_off = time.time()
            self._fence.expire()
            self._supervisor.is_cut_off = True
            self._say(
                "cut off from its manager, which may start movable components "
                "elsewhere: they are inactive here until it says what runs where"
            )

    def note_told(self) -> None:
        """Do what the manager says, which knows what runs elsewhere."""
        if self.cut_off:
            self.cut_off = 0.0
            self._supervisor.is_cut_off = self._heartbeats.is_cut_off = False
            self._say("reached by its manager again")
