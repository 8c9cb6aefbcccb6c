"""Takes steps in their order, until a deployment overtakes them."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial

from poise.errors import PoiseError, RunError, said
from poise.wire.records.deployment_records import ContainerSpec
from poise.wire.records.migration_records import (
    MigrationSteps,
    Step,
    StepsDone,
    StepsFailed,
    StepsOutcome,
    StepTaken,
    Targets,
)

_SHARE = 0.75
"""Steps may take this share of their limit: the rest is for the answer, so that the
manager learns which step was too slow, and of what component."""


class StepTaker(ABC):
    """Takes steps in one container, on any thread; `now`: the clock of steps [s]."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._beginning = threading.Lock()
        self._num_deployments = 0
        self._targets: Targets = ()
        self._is_committed = False
        self._deployed: ContainerSpec | None = None

    def note_deployment(self, spec: ContainerSpec) -> None:
        """Refuse the steps received until now: a manager's deployment counts."""
        with self._beginning:
            self._num_deployments += 1
            if self._deployed is None or not self._deployed.agrees_with(spec):
                self._deployed, self._targets, self._is_committed = spec, (), False

    def halt(self, batch: MigrationSteps) -> StepsDone:
        """Refuse the steps that were received until now; return how far they got."""
        with self._beginning:
            self._num_deployments += 1
            return StepsDone(
                batch.number, targets=self._targets, is_committed=self._is_committed
            )

    def receive(self, batch: MigrationSteps) -> Callable[[], StepsOutcome]:
        """Return what takes steps that came just now."""
        return partial(self._carry_out_all, batch, self._now(), self._num_deployments)

    def _carry_out_all(
        self, batch: MigrationSteps, received: float, deployment: int
    ) -> StepsOutcome:
        deadline = received + _SHARE * batch.limit
        taken: list[StepTaken] = []
        try:
            for step in batch.steps:
                self._begin(step, deployment, batch.targets)
                began = self._now()
                self._carry_out(step, batch.migration, deadline)
                ended = self._now()
                is_sender = not step.component
                who = batch.container if is_sender else f"{step.component}/{step.epoch}"
                taken.append(StepTaken(who, step.name, step.phase, began, ended))
        except PoiseError as error:
            return StepsFailed(batch.number, said(error), tuple(taken))
        return StepsDone(batch.number, tuple(taken))

    def _begin(self, step: Step, deployment: int, targets: Targets) -> None:
        """Note whether there is a way back; raise RunError for a step overtaken."""
        with self._beginning:
            if deployment != self._num_deployments:
                raise RunError(f"'{step.name}' was overtaken by a deployment")
            if targets != self._targets:
                self._targets, self._is_committed = targets, False
            if step.phase in {"commit", "resume"}:
                self._is_committed = True

    @abstractmethod
    def _carry_out(self, step: Step, migration: int, deadline: float) -> None:
        """Take one step of a migration until a moment, or raise PoiseError."""
