"""Brings agents to what should run, whatever they were sent before.

It waits for nothing and raises nothing: what an agent refuses, or does not answer in
time, is a deviation, and is tried again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from msgspec import Struct, structs

from poise.clock import Clock
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.reports import LOOK_EVERY
from poise.manage.agent_connections.requests import (
    ANSWER_LIMIT,
    PendingAnswer,
    keep_limit,
    reason_of,
    why_not_kept,
)
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import MigrationSteps, Step, StepsDone
from poise.wire.records.request_records import Accepted, CheckpointCopy, Claimed
from poise.wire.records.status_records import AgentStatus

APPLY_LIMIT = 1.0
"""It reports within this time that it works towards what it accepted [s]; else it is
sent again, which is harmless."""
TRY_AGAIN = 1.0
"""An agent that refused or did not answer is asked again after this time [s]."""


class _AskedAgent(Struct):
    sent: Deployment | None = None
    start: tuple[int, str] = 0, ""
    sent_at: float = float("-inf")
    again_at: float = float("-inf")
    reply: PendingAnswer | None = None
    is_claim: bool = False
    trouble: str = ""
    refusal: str = ""


class Reconciler:
    """Compares and tells; for the manager's thread."""

    def __init__(
        self, agents: Agents, clock: Clock, on_claimed: Callable[[str, Claimed], object]
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
        agent, now = self._known.get(computer), self._clock.now()
        if agent is None:
            agent = self._known[computer] = _AskedAgent()
        if agent.reply is not None and self._note_answer(computer, agent, now):
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
        agent.sent, agent.start, agent.sent_at = wanted, status.start, now
        agent.refusal = ""
        agent.reply = self._agents.begin_deploy(computer, wanted)
        agent.is_claim = False
        self._note_answer(computer, agent, now)

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

    def _is_sent(
        self, agent: _AskedAgent, wanted: Deployment, status: AgentStatus, now: float
    ) -> bool:
        sent = agent.sent
        if sent is None or agent.start != status.start or not _same(sent, wanted):
            return False
        if agent.reply is not None:
            return True
        if agent.refusal:
            return False
        return status.generation >= sent.generation or now < agent.sent_at + APPLY_LIMIT

    def _note_answer(self, computer: str, agent: _AskedAgent, now: float) -> bool:
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
            why = f"refused: {reason_of(answer)}"
            agent.refusal = f"the agent of '{computer}' {why}"
        agent.trouble = f"the agent of '{computer}' {why}"
        return False


def _same(sent: Deployment, wanted: Deployment) -> bool:
    """Return whether two deployments say the same, whenever that is."""
    return structs.replace(sent, generation=wanted.generation) == wanted


HALT_LIMIT = 1.0
"""Containers say within this time how far a half-done migration came [s]."""
WITNESS_LIMIT = 5.0
"""Containers that do not say so are asked again for this time [s]."""


def halt(number: int, container: str) -> MigrationSteps:
    """Return what lets a container go on with nothing of a migration."""
    return MigrationSteps(number, 0, container, (Step("halt"),), HALT_LIMIT)


class JoiningComputer:
    """Asks the containers of targets whether these count; waits for nothing.

    Its agent gets the checkpoints that it lacks before anything is started there.
    `deployment`: what it works towards; `committed`: the targets that count. That of a
    container which does not answer does, too: unknown is never taken for "no".
    """

    def __init__(
        self,
        computer: str,
        deployment: Deployment,
        agents: Agents,
        clock: Clock,
        numbers: Iterator[int],
        *,
        is_cut_off: bool,
        lacking: Iterable[CheckpointCopy] = (),
    ) -> None:
        self.deployment = deployment
        self.is_cut_off = is_cut_off
        self.committed: set[tuple[str, int]] = set()
        self._computer = computer
        self._agents = agents
        self._clock = clock
        self._numbers = numbers
        self._targets = {
            container.name: targets
            for container in deployment.containers
            if (
                targets := {
                    component.key
                    for component in container.components
                    if component.goal == "inactive" and not component.held
                }
            )
        }
        self._asked: dict[str, PendingAnswer] = {}
        self._again_at = float("-inf")
        self._until = clock.now() + WITNESS_LIMIT
        self._sent = [(copy, agents.begin_keeping(computer, copy)) for copy in lacking]
        self._sent_until = clock.now() + max(
            [keep_limit(copy) for copy, _ in self._sent], default=0.0
        )

    def is_known(self) -> bool:
        """Take in what was answered, and ask again; return whether all is known."""
        now = self._clock.now()
        asks = bool(self._targets or self._sent)
        if asks and not self._agents.obey(self._computer):
            self._until = now + WITNESS_LIMIT
            return False
        for container, reply in self._asked.items():
            if isinstance(reply.answer, StepsDone):
                self._targets.pop(container, None)
                if reply.answer.is_committed:
                    self.committed |= set(reply.answer.targets)
        if self._targets and now >= self._until:
            self.committed.update(*self._targets.values())
            self._targets = {}
        self._ask(now)
        is_sent = all(reply.is_done for _, reply in self._sent)
        return not self._targets and (is_sent or now >= self._sent_until)

    def checkpoints(self) -> Iterator[tuple[CheckpointCopy, str]]:
        """Yield what its agent got, and why it did not keep that; empty: it did."""
        for copy, reply in self._sent:
            yield copy, why_not_kept(copy, reply.answer)

    def _ask(self, now: float) -> None:
        for container in self._targets:
            reply = self._asked.get(container)
            if reply is None or (reply.is_done and now >= self._again_at):
                steps = halt(next(self._numbers), container)
                self._asked[container] = self._agents.begin_steps(self._computer, steps)
                self._again_at = now + LOOK_EVERY
