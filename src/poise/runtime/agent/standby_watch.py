"""Wakes the standby of an agent's computer when the agent hears no leader any more."""

from __future__ import annotations

from math import inf

from poise.runtime.agent.fence import Fence
from poise.runtime.agent.heartbeat_exchange import HeartbeatExchange
from poise.runtime.agent.surroundings import Surroundings
from poise.wire.records.request_records import Election

_RANK, _SPREAD = 0.06, 0.04
"""Each next computer of the list waits so much longer, and a part of this [s]."""
_WAYS = 6.0
"""An election takes this many times the delay of the slowest link, one way."""
_LONGEST = 2.0
"""But no longer than this [s]: it waits for no vote for more than a second."""
_AGAIN = 1.0
"""When there is still no leader, it tries again after this time, or twice that [s]."""


class StandbyWatch:
    """For the agent's thread; does nothing where managers are not voted for."""

    def __init__(
        self,
        computer: str,
        heartbeats: HeartbeatExchange,
        fence: Fence,
        world: Surroundings,
    ) -> None:
        self._computer = computer
        self._heartbeats = heartbeats
        self._fence = fence
        self._world = world
        self._due = inf
        self._has_standby = False
        # why the standby is not woken that should lead; empty: nothing hinders it
        self.trouble = ""

    def look(self, *, is_over: bool) -> None:
        """Keep a standby, and wake it when nobody leads; `is_over`: nothing runs."""
        claim = self._heartbeats.claim
        election = claim.election if claim is not None else None
        is_wanted = election is not None and self._computer in election.managers
        if election is None or not is_wanted or is_over:
            self.close()
            return
        self._has_standby = True
        self._world.standby.keep(claim)
        now = self._world.clock.now()
        if self._fence.is_managed() and now < self._heartbeats.leader_silent_from():
            self._due, self.trouble = inf, ""
        elif self._due == inf:
            self._due = now + self._pause(election)
        elif now >= self._due:
            self._wake()
            wait = _AGAIN + self._election_time()
            self._due = now + wait * (1 + self._world.random.random())

    def moment(self) -> float:
        """Return when `look` has something to do [s]."""
        if not self._has_standby:
            return inf
        return min(self._due, self._silent_from())

    def close(self) -> None:
        """Let no standby wait."""
        if self._has_standby:
            self._world.standby.keep(None)
        self._has_standby, self._due, self.trouble = False, inf, ""

    def _wake(self) -> None:
        """Wake the standby, unless its claim would disturb agents for nothing."""
        before, silent = self.trouble, ", ".join(self._heartbeats.unanswering())
        self.trouble = silent and (
            "no standby can lead: most votes are missing, since heartbeats (UDP) are "
            f"not answered by {silent} (does a firewall let them through, both ways?)"
        )
        if not self.trouble:
            self._world.say("no manager leads the robot: the standby here tries to")
            self._world.standby.lead()
        elif self.trouble != before:
            self._world.say(self.trouble)

    def _silent_from(self) -> float:
        """Return when the leader would be silent; never when it is known to be."""
        return self._heartbeats.leader_silent_from() if self._due == inf else inf

    def _pause(self, election: Election) -> float:
        rank = election.managers.index(self._computer)
        rank_wait = _RANK + self._election_time()  # else they disturb each other
        return rank_wait * rank + _SPREAD * self._world.random.random()

    def _election_time(self) -> float:
        """Return how long messages of an election are on their way [s]."""
        ways = self._heartbeats.links().values()
        slowest = max((way.delay or 0.0 for way in ways), default=0.0)
        return min(_WAYS * slowest, _LONGEST)
