"""Who a manager is, which agents it has claimed, and which of several gives way."""

from __future__ import annotations

import getpass
import os
import socket
import uuid
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace

from poise.clock import wall_time
from poise.wire.records.request_records import (
    Answer,
    Claim,
    Claimed,
    Election,
    ManagerId,
    majority_at,
)
from poise.wire.records.status_records import AgentStatus

_REVOKED = 2
"""A token that was revoked counts as one so much higher, which no agent has."""


class Claims:
    """The claims of one manager on agents, each by a token that is new to its agent."""

    def __init__(
        self,
        manager: ManagerId,
        endpoints: Mapping[str, str],
        election: Election | None,
        *,
        is_leased: bool,
    ) -> None:
        self.manager = manager
        self.election = election
        self.votes = election.votes if election is not None else {}
        self.tokens: dict[str, int] = {}
        self.accepted: dict[str, int] = {}
        self._endpoints = endpoints
        self._is_leased = is_leased
        self._told: dict[str, int] = {}

    def begin_term(self, statuses: Iterable[AgentStatus]) -> None:
        """Take a term that is higher than those of all managers that agents obey."""
        if not self.accepted:
            terms = [s.manager.term for s in statuses if s.manager is not None]
            self.manager = replace(self.manager, term=max(terms, default=0) + 1)

    def new(
        self, computer: str, status: AgentStatus | None, *, take_over: bool = False
    ) -> Claim:
        """Return a claim with a token that its agent has not seen."""
        known = status.token if status is not None else 0
        self.tokens[computer] = max(known, self.tokens.get(computer, 0)) + 1
        return Claim(
            self.manager, take_over, self._endpoints, self._is_leased, self.election
        )

    def accept(
        self, computer: str, answer: Answer | None, token: int | None = None
    ) -> None:
        """Note that an agent accepted the claim with a token, by default the last."""
        self.accepted[computer] = self.tokens[computer] if token is None else token
        found = answer.deployment if isinstance(answer, Claimed) else None
        self.note_told(computer, found.generation if found is not None else 0)

    def revoke(self, computers: Iterable[str]) -> None:
        """Need new claims on agents of computers that are lost."""
        for name in computers:
            self.tokens[name] = self.tokens.get(name, 0) + _REVOKED

    def note_told(self, computer: str, generation: int) -> None:
        """Note what an agent was told should run, by this manager or one before."""
        self._told[computer] = max(self._told.get(computer, 0), generation)

    def is_obeyed(self, status: AgentStatus) -> bool:
        """Return whether an agent obeys this manager, as it reported."""
        token = self.tokens.get(status.computer)
        return status.token == token == self.accepted.get(status.computer)

    def has_majority(self, computers: Iterable[str]) -> bool:
        """Return whether agents of these computers have most of the votes."""
        return majority_at(self.votes, dict.fromkeys(computers, 0.0)) == 0.0

    def successor(self, reached: Sequence[AgentStatus]) -> ManagerId | None:
        """Return the manager to which this one gives way; None: there is none."""
        if self.election is not None and self.accepted:
            # an agent that voted for another one refuses this one from then on
            voted = [s.manager for s in reached if s.manager is not None]
            others = [m for m in voted if m.key != self.manager.key]
            later = [m for m in others if m.term >= self.manager.term]
            if later:
                return max(later, key=lambda manager: manager.rank)
        return gives_way_to(self.manager, self.accepted, self._told, reached)


def manager_id(control: str = "") -> ManagerId:
    """Return an identity for a manager that starts now, with its control socket."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # it has no name
        user = str(os.getuid())
    return ManagerId(
        key=uuid.uuid4().hex,
        user=user,
        host=socket.gethostname(),
        pid=os.getpid(),
        since=wall_time(),
        control=control,
    )


def has_ended(manager: ManagerId) -> bool:
    """Return whether a manager of this computer has ended; False where unknown."""
    is_here = manager.host == socket.gethostname()
    return is_here and not Path(f"/proc/{manager.pid}").exists()


def gives_way_to(
    manager: ManagerId,
    claimed: Mapping[str, int],
    told: Mapping[str, int],
    statuses: Iterable[AgentStatus],
) -> ManagerId | None:
    """Return the manager to which this one gives way; None: there is none.

    It is a later one that an agent obeys, or one that all agents obey which this one
    has claimed. So of two managers one gives way, whatever each of them sees. Also when
    the other is gone, if it told an agent of this one what should run: this one would
    undo it.

    `told`: computer -> the last generation that this one told its agent, or found.
    """
    others = {
        status.computer: status.manager
        for status in statuses
        if status.manager is not None
        and status.manager.key != manager.key
        and (
            not status.unmanaged
            or status.generation > told.get(status.computer, status.generation)
        )
        and status.token > claimed.get(status.computer, -1)
    }
    last = max(others.values(), key=lambda other: other.rank, default=None)
    has_lost_all = bool(claimed) and claimed.keys() <= others.keys()
    is_later = last is not None and last.rank > manager.rank
    return last if is_later or has_lost_all else None
