"""A container's side of a migration: it takes the steps that the manager sends.

Each step is harmless when repeated, and leaves all as it was when it fails. A step may
be taken after the manager gave it up. Then the phases of the incarnation
(`poise.wire.migration_phases`) refuse it, or the next deployment undoes it and refuses
what comes later. What each step is for: docs/design/moves.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from poise.errors import PoiseError, RunError, Timeout
from poise.priority import as_usual
from poise.runtime.component.error_report import told_in_brief
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import Runners, Transports, Wiring
from poise.runtime.migration.state_receiver import StateReceiver
from poise.runtime.migration.state_sender import StateSender, key_of
from poise.wire.migration_phases import MigrationPhases, Role
from poise.wire.records.migration import (
    Activate,
    AwaitIdle,
    Buffer,
    ComponentStep,
    DrainChannels,
    DrainMailbox,
    MigrationSteps,
    OfferState,
    Pause,
    PreCopy,
    Redirect,
    Release,
    RequestState,
    RestoreState,
    Resume,
    RollBack,
    SenderStep,
    SendState,
    StepsDone,
    StepsFailed,
    StepsOutcome,
    StepTaken,
    name_of_step,
)

_SHARE = 0.75
"""Steps may take this share of their limit: the rest is for the answer, so that the
manager learns which step was too slow, and of what component."""
_POLL = 0.001
"""A mailbox does not tell when it is empty; look this often [s]."""
_PAUSE_SHARE = 0.8
"""A pause may take this share of that, so that targets learn why they get no state
before they give up."""


class Party:
    """One incarnation's part in one migration."""

    def __init__(self, runner: Runner, role: Role, migration: int) -> None:
        self.runner = runner
        self.migration = migration
        self.phases = MigrationPhases(role, f"component '{runner.spec.name}'")
        self._sender: StateSender | None = None
        self._receiver: StateReceiver | None = None
        self._stop_serving: Callable[[], None] | None = None

    @property
    def sender(self) -> StateSender:
        """Its state transfer as a source."""
        if self._sender is None:
            raise RunError(f"component '{self.runner.spec.name}' offers no state")
        return self._sender

    @property
    def receiver(self) -> StateReceiver:
        """Its state transfer as a target."""
        if self._receiver is None:
            raise RunError(f"component '{self.runner.spec.name}' receives no state")
        return self._receiver

    def offer(self, transports: Transports) -> None:
        """Serve the state to targets."""
        self.close()
        spec = self.runner.spec
        key = key_of(spec.name, spec.epoch, self.migration)
        self._sender = StateSender(self.runner)
        transports.server.open(key, self._sender.handle)
        self._stop_serving = partial(transports.server.shut, key)

    def pre_copy(self, step: PreCopy, transports: Transports, deadline: float) -> None:
        """Connect to the sources."""
        self.close()
        self._receiver = StateReceiver(
            self.runner, step, self.migration, transports.channel
        )
        self._receiver.connect(deadline)

    def refuse(self, reason: str) -> None:
        """Tell targets, if there are any, why they get no state."""
        if self._sender is not None:
            self._sender.refuse(reason)

    def close(self) -> None:
        """Transfer nothing any more; harmless when repeated."""
        self.refuse("the offer is withdrawn")
        if self._stop_serving is not None:
            self._stop_serving()
        if self._receiver is not None:
            self._receiver.close()
        self._sender = self._receiver = self._stop_serving = None


class MigrationExecutor:
    """Takes steps in one container, on any thread."""

    def __init__(
        self, runners: Runners, wiring: Wiring, transports: Transports
    ) -> None:
        self._runners = runners
        self._wiring = wiring
        self._transports = transports
        self._parties: dict[Runner, Party] = {}
        self._num_deployments = 0

    def note_deployment(self) -> None:
        """Refuse the steps that were received until now: a deployment says what is so.

        The next migration of the same component may follow, and needs none of them.
        """
        self._num_deployments += 1

    def receive(self, batch: MigrationSteps) -> Callable[[], StepsOutcome]:
        """Return what takes steps that came just now."""
        return partial(self._take_all, batch, time.monotonic(), self._num_deployments)

    def forget(self, runner: Runner) -> None:
        """Know no more of an incarnation that has ended."""
        if runner in self._parties:
            self._parties.pop(runner).close()

    def _take_all(
        self, batch: MigrationSteps, received: float, deployment: int
    ) -> StepsOutcome:
        deadline = received + _SHARE * batch.limit
        taken: list[StepTaken] = []
        try:
            for step in batch.steps:
                name = name_of_step(step)
                self._refuse_late(name, deployment)
                began = time.monotonic()
                who = batch.container
                if isinstance(step, Buffer | Release):
                    self._take_at_senders(step, batch.migration)
                else:
                    who = f"{step.component}/{step.epoch}"
                    self._take(step, batch.migration, deadline)
                ended = time.monotonic()
                taken.append(StepTaken(who, name, step.phase, began, ended))
        except PoiseError as error:
            return StepsFailed(batch.number, str(error), tuple(taken))
        except Exception as error:  # noqa: BLE001, a user's restore may raise anything
            return StepsFailed(batch.number, told_in_brief(error), tuple(taken))
        return StepsDone(batch.number, tuple(taken))

    def _refuse_late(self, step: str, deployment: int) -> None:
        if deployment != self._num_deployments:
            raise RunError(f"'{step}' is late: a deployment came before it")

    def _take_at_senders(self, step: SenderStep, migration: int) -> None:
        match step:
            case Buffer(connectors):
                for name in connectors:
                    sender = self._wiring.sender(name)
                    sender.buffer_for_move()
                    sender.send_marker(migration)
            case Release(keys):
                for key in keys:
                    self._wiring.sender_to(key).switch(key)

    def _take(self, step: ComponentStep, migration: int, deadline: float) -> None:
        runner = self._runner(step.component, step.epoch)
        if isinstance(step, DrainChannels):
            markers = dict.fromkeys(step.connectors, migration)
            runner.endpoints.wait_markers(markers, _left(deadline))
            return
        party = self._party(runner, step.role, migration)
        with party.phases.taking(name_of_step(step), step.phase):
            self._take_at(party, step, deadline)

    def _take_at(  # noqa: C901, a table
        self, party: Party, step: ComponentStep, deadline: float
    ) -> None:
        runner = party.runner
        match step:
            case OfferState():
                party.offer(self._transports)
            case PreCopy():
                with as_usual():  # a large state takes its time, and nobody waits
                    party.pre_copy(step, self._transports, deadline)
            case RequestState():
                party.receiver.request()
            case AwaitIdle():
                runner.gate.wait_idle(min(step.limit, _left(deadline)))
            case Pause():
                _pause(party, _left(deadline))
            case DrainMailbox():
                _drain_mailbox(runner, deadline)
            case SendState():
                party.sender.send()
            case RestoreState():
                party.receiver.restore(_left(deadline))
            case Activate():
                _activate(runner, _left(deadline))
            case Redirect():
                runner.exclusion.redirect()
            case Resume() | RollBack():
                runner.aim("active")
                party.refuse("it is at work again")

    def _runner(self, component: str, epoch: int) -> Runner:
        try:
            return self._runners[component, epoch]
        except KeyError:
            raise RunError(f"component '{component}' ({epoch}) is not here") from None

    def _party(self, runner: Runner, role: Role, migration: int) -> Party:
        """Return an incarnation's part in a migration, which may begin with that."""
        party = self._parties.get(runner)
        if party is None or party.migration < migration:
            self.forget(runner)
            party = self._parties[runner] = Party(runner, role, migration)
        if party.migration > migration:
            raise RunError(
                f"component '{runner.spec.name}': the step belongs to migration "
                f"{migration}, and {party.migration} has begun"
            )
        return party


def _pause(party: Party, limit: float) -> None:
    try:
        party.runner.gate.pause_for_migration(_PAUSE_SHARE * limit)
    except PoiseError as error:
        party.refuse(str(error))
        raise
    for sender in list(party.runner.endpoints.senders.values()):
        sender.send_marker(party.migration)


def _drain_mailbox(runner: Runner, deadline: float) -> None:
    while not runner.endpoints.is_empty():
        if time.monotonic() > deadline:
            raise Timeout(
                f"component '{runner.spec.name}' did not handle all messages that wait"
            )
        time.sleep(_POLL)


def _activate(runner: Runner, limit: float) -> None:
    runner.aim("ready")
    if runner.life_cycle.wait_state({"active", "failed"}, limit) != "active":
        error = runner.status().error or f"waited {limit:g} s"
        raise RunError(f"component '{runner.spec.name}' is not activated: {error}")


def _left(deadline: float) -> float:
    return max(0.0, deadline - time.monotonic())
