"""A computer that a manager claims once it has taken the robot over.

Of a move that was half done when the manager before ended, the target may be there. Its
container knows whether that move was committed; its lease may have ended since.
"""

from __future__ import annotations

from collections.abc import Iterator

from poise.clock import Clock
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.reports import LOOK_EVERY
from poise.manage.agent_connections.requests import PendingAnswer
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import MigrationSteps, Step, StepsDone

HALT_LIMIT = 1.0
"""Containers say within this time how far a half-done migration came [s]."""
WITNESS_LIMIT = 5.0
"""Containers that do not say so are asked again for this time [s]."""


def halt(number: int, container: str) -> MigrationSteps:
    """Return what lets a container go on with nothing of a migration."""
    return MigrationSteps(number, 0, container, (Step("halt"),), HALT_LIMIT)


class JoiningComputer:
    """Asks the containers of targets whether these count; waits for nothing.

    `deployment`: what its agent works towards.
    `is_cut_off`: whether its lease had ended when it was claimed.
    `committed`: component and epoch of targets that count. That of a container which
    does not answer does, too: unknown is never taken for "no".
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
                    (component.name, component.epoch)
                    for component in container.components
                    if component.goal == "inactive" and not component.held
                }
            )
        }
        self._asked: dict[str, PendingAnswer] = {}
        self._again_at = float("-inf")
        self._until = clock.now() + WITNESS_LIMIT

    def is_known(self) -> bool:
        """Take in what was answered, and ask the others again; return whether all is.

        While the computer is out of reach nothing is known.
        """
        now = self._clock.now()
        if self._targets and not self._agents.obey(self._computer):
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
        return not self._targets

    def _ask(self, now: float) -> None:
        for container in self._targets:
            reply = self._asked.get(container)
            if reply is None or (reply.is_done and now >= self._again_at):
                steps = halt(next(self._numbers), container)
                self._asked[container] = self._agents.begin_steps(self._computer, steps)
                self._again_at = now + LOOK_EVERY
