"""A container's side of a migration: it takes the steps that the manager sends.

Each step is harmless when repeated, and leaves all as it was when it fails. A step may
be taken after the manager gave it up. Then the phases of the incarnation refuse it, or
the next deployment undoes it and refuses what comes later. Phases, and what each step
is for: `poise.wire.records.migration_records`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial

from poise.errors import PoiseError, RunError
from poise.runtime.component.error_report import told_in_brief
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import Runners, Wiring
from poise.runtime.migration.participant import Participant
from poise.runtime.waker import poll_until
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.records.deployment import ContainerSpec
from poise.wire.records.migration_records import (
    MigrationSteps,
    Role,
    Step,
    StepsDone,
    StepsFailed,
    StepsOutcome,
    StepTaken,
)

_SHARE = 0.75
"""Steps may take this share of their limit: the rest is for the answer, so that the
manager learns which step was too slow, and of what component."""


class MigrationExecutor:
    """Takes steps in one container, on any thread."""

    def __init__(
        self, runners: Runners, wiring: Wiring, server: ConnectionServer
    ) -> None:
        self._runners = runners
        self._wiring = wiring
        self._server = server
        self._participants: dict[Runner, Participant] = {}
        self._beginning = threading.Lock()
        self._num_deployments = 0
        self._is_committed = False
        self._told: ContainerSpec | None = None

    def note_deployment(self, spec: ContainerSpec) -> None:
        """Refuse the steps that were received until now: a deployment says what is so.

        The next migration of the same component may follow, and needs none of them.
        When a lease ends, or an agent starts again, no manager says so: then it stays
        known how far the steps got.
        """
        with self._beginning:
            self._num_deployments += 1
            if self._told is None or not self._told.is_told_by(spec):
                self._told, self._is_committed = spec, False

    def halt(self, batch: MigrationSteps) -> StepsDone:
        """Refuse the steps that were received until now; return how far they got."""
        with self._beginning:
            self._num_deployments += 1
            return StepsDone(batch.number, is_committed=self._is_committed)

    def receive(self, batch: MigrationSteps) -> Callable[[], StepsOutcome]:
        """Return what takes steps that came just now."""
        return partial(self._take_all, batch, time.monotonic(), self._num_deployments)

    def forget(self, runner: Runner) -> None:
        """Know no more of an incarnation that has ended."""
        if runner in self._participants:
            self._participants.pop(runner).close()

    def _take_all(
        self, batch: MigrationSteps, received: float, deployment: int
    ) -> StepsOutcome:
        deadline = received + _SHARE * batch.limit
        taken: list[StepTaken] = []
        try:
            for step in batch.steps:
                self._begin(step, deployment)
                began = time.monotonic()
                self._take(step, batch.migration, deadline)
                ended = time.monotonic()
                is_sender = not step.component
                who = batch.container if is_sender else f"{step.component}/{step.epoch}"
                taken.append(StepTaken(who, step.name, step.phase, began, ended))
        except PoiseError as error:
            return StepsFailed(batch.number, str(error), tuple(taken))
        except Exception as error:  # noqa: BLE001, a user's restore may raise anything
            return StepsFailed(batch.number, told_in_brief(error), tuple(taken))
        return StepsDone(batch.number, tuple(taken))

    def _begin(self, step: Step, deployment: int) -> None:
        """Note whether there is a way back; raise RunError when the step is late."""
        with self._beginning:
            if deployment != self._num_deployments:
                text = f"'{step.name}' is late: a deployment came before it"
                raise RunError(text)
            if step.phase in {"commit", "resume"}:
                self._is_committed = True

    def _take(self, step: Step, migration: int, deadline: float) -> None:
        match step.name:
            case "buffer":
                self._buffer(step, migration)
            case "release to targets" | "release to sources":
                for key in step.connectors:
                    self._wiring.sender(key).switch(key)
                for key in step.connectors:
                    sender = self._wiring.sender(key)
                    text = f"connector {sender.name}: a call has no answer yet from "
                    text += "the computer that its target left"
                    poll_until(sender.has_left, deadline, text)
            case "drain channels":
                markers = dict.fromkeys(step.connectors, migration)
                left = max(0.0, deadline - time.monotonic())
                for key in step.late:
                    self._wiring.shut(key)
                self._runner(step).endpoints.wait_markers(markers, left)
        if step.role is not None:
            participant = self._participant(self._runner(step), step.role, migration)
            with participant.phases.taking(step.name, step.phase):
                participant.take(step, deadline)

    def _buffer(self, step: Step, migration: int) -> None:
        for name in step.connectors:
            sender = self._wiring.sender(name)
            sender.buffer_for_move()
            sender.send_marker(migration)
        for key, keep in step.late.items():
            sender = self._wiring.sender(key)
            sender.buffer_for_move(keep)
            if route := sender.routes().get(key):
                route.give_up()

    def _runner(self, step: Step) -> Runner:
        try:
            return self._runners[step.component, step.epoch]
        except KeyError:
            text = f"component '{step.component}' ({step.epoch}) is not here"
            raise RunError(text) from None

    def _participant(self, runner: Runner, role: Role, migration: int) -> Participant:
        """Return an incarnation's part in a migration, which may begin with that."""
        participant = self._participants.get(runner)
        if participant is None or participant.migration < migration:
            self.forget(runner)
            participant = Participant(runner, role, migration, self._server)
            self._participants[runner] = participant
        if participant.migration > migration:
            raise RunError(
                f"component '{runner.spec.name}': the step belongs to migration "
                f"{migration}, and {participant.migration} has begun"
            )
        return participant
