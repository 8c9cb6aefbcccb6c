"""Brings agents to what should run, whatever they were sent before.

Each step compares what every agent reports with what should run on its computer, and
takes the smallest step: it claims an agent that does not obey, or tells one what has
changed. It waits for nothing and raises nothing. What an agent refuses, or does not
answer in time, is a deviation, and is tried again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from msgspec import structs

from poise.clock import Clock
from poise.manage.agent_connections.requests import ANSWER_LIMIT, PendingAnswer
from poise.manage.agent_connections.statuses import Statuses
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.request_records import Accepted, Claimed, ManagerId, Refused
from poise.wire.records.status_records import AgentStatus

APPLY_LIMIT = 1.0
"""It reports within this time that it works towards what it accepted [s]; else it is
sent again, which is harmless."""
TRY_AGAIN = 1.0
"""An agent that refused or did not answer is asked again after this time [s]."""


class ReconciledAgents(Protocol):
    """What the reconciler needs of the manager's connections to agents."""

    def statuses(self) -> Statuses:
        """Return what each agent reported last."""
        ...

    def out_of_reach(self) -> Mapping[str, float]:
        """Return the agents that are not reached."""
        ...

    def obey(self, computer: str) -> bool:
        """Return whether an agent is reached and obeys this manager."""
        ...

    def successor(self) -> ManagerId | None:
        """Return the manager to which this one gives way; None: there is none."""
        ...

    def begin_claim(self, computer: str) -> PendingAnswer:
        """Ask an agent to obey this manager; do not wait."""
        ...

    def end_claim(self, computer: str, reply: PendingAnswer) -> None:
        """Take note that an agent accepted a claim."""
        ...

    def begin_deploy(self, computer: str, deployment: Deployment) -> PendingAnswer:
        """Tell an agent what should run; do not wait."""
        ...


class _AskedAgent:
    """What was asked of one agent."""

    def __init__(self) -> None:
        self.sent: Deployment | None = None
        self.pid = 0
        self.sent_at = self.again_at = float("-inf")
        self.reply: PendingAnswer | None = None
        self.is_claim = False
        self.trouble = ""
        self.refusal = ""


class Reconciler:
    """Compares and tells; for the manager's thread."""

    def __init__(
        self,
        agents: ReconciledAgents,
        clock: Clock,
        on_claimed: Callable[[str, Claimed], object],
    ) -> None:
        self._agents = agents
        self._clock = clock
        self._on_claimed = on_claimed
        self._known: dict[str, _AskedAgent] = {}

    def step(self, computer: str, wanted: Deployment | None) -> None:
        """Take the smallest step towards what should run on a computer.

        `wanted`: None: what runs there is to be known first; it is only claimed.
        """
        away = self._agents.out_of_reach()
        status = None if computer in away else self._agents.statuses().get(computer)
        self._bring(computer, wanted, status)

    def troubles(self) -> dict[str, str]:
        """Return computer -> what its agent refuses or does not answer, for people."""
        known = self._known.copy()
        return {name: agent.trouble for name, agent in known.items() if agent.trouble}

    def is_current(self, computer: str, status: AgentStatus) -> bool:
        """Return whether a status speaks of what its agent was sent last."""
        agent = self._known.get(computer)
        sent = agent.sent if agent else None
        return sent is not None and status.generation >= sent.generation

    def refusal(self, computer: str) -> str:
        """Return why an agent refuses what it was sent last; empty: it does not."""
        agent = self._known.get(computer)
        return agent.refusal if agent else ""

    def _bring(
        self, computer: str, wanted: Deployment | None, status: AgentStatus | None
    ) -> None:
        agent, now = self._known.get(computer), self._clock.now()
        if agent is None:
            agent = self._known[computer] = _AskedAgent()
        if agent.reply is not None and self._take(computer, agent, now):
            return  # what should run may be different, now that it was claimed
        if status is None:  # it is sent when it is back
            agent.trouble = agent.refusal = ""
            agent.sent = None
            return
        if not self._agents.obey(computer):
            agent.sent = None
            is_due = agent.reply is None and now >= agent.again_at
            if is_due and self._agents.successor() is None:
                agent.reply = self._agents.begin_claim(computer)
                agent.is_claim, agent.sent_at = True, now
            return
        if wanted is None or (agent.is_claim and agent.reply is not None):
            return
        if self.is_current(computer, status) and not agent.refusal:
            agent.trouble = ""  # it took what it did not answer
        if self._is_sent(agent, wanted, status, now) or (
            agent.sent is not None
            and now < agent.again_at
            and _same(agent.sent, wanted)
        ):
            return
        agent.sent, agent.pid, agent.sent_at = wanted, status.pid, now
        agent.refusal = ""
        agent.reply = self._agents.begin_deploy(computer, wanted)
        agent.is_claim = False
        self._take(computer, agent, now)

    def _is_sent(
        self, agent: _AskedAgent, wanted: Deployment, status: AgentStatus, now: float
    ) -> bool:
        sent = agent.sent
        if sent is None or agent.pid != status.pid or not _same(sent, wanted):
            return False
        if agent.reply is not None:
            return True
        if agent.refusal:
            return False
        return status.generation >= sent.generation or now < agent.sent_at + APPLY_LIMIT

    def _take(self, computer: str, agent: _AskedAgent, now: float) -> bool:
        """Take in an answer, if it is there or late; return whether it is claimed."""
        reply = agent.reply
        is_late = now >= agent.sent_at + ANSWER_LIMIT
        if reply is None or not (reply.is_done or is_late):
            return False
        agent.reply = None
        answer = reply.answer
        if isinstance(answer, Accepted | Claimed):
            agent.trouble = agent.refusal = ""
            agent.again_at = now + APPLY_LIMIT if agent.is_claim else float("-inf")
            if isinstance(answer, Claimed):
                self._agents.end_claim(computer, reply)
                self._on_claimed(computer, answer)
            return isinstance(answer, Claimed)
        agent.again_at = now + TRY_AGAIN
        if answer is None and not is_late:
            return False  # its connection broke: that it is lost is known soon
        why = f"did not answer within {ANSWER_LIMIT:g} s"
        if answer is not None:
            reason = answer.reason if isinstance(answer, Refused) else str(answer)
            why = f"refused: {reason}"
            agent.refusal = f"the agent of '{computer}' {why}"
        agent.trouble = f"the agent of '{computer}' {why}"
        return False


def _same(sent: Deployment, wanted: Deployment) -> bool:
    """Return whether two deployments say the same, whenever that is."""
    return structs.replace(sent, generation=wanted.generation) == wanted
