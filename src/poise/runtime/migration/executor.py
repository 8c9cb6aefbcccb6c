"""A container's side of a migration: it takes the steps that the manager sends.

Each step is harmless when repeated, and leaves all as it was when it fails.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping

from poise.errors import PoiseError, RunError, UsageError
from poise.priority import as_usual
from poise.runtime.component.error_report import brief_traceback
from poise.runtime.component.implementation import fingerprint
from poise.runtime.component.ports import Port
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import Runners, Wiring
from poise.runtime.migration.state_transfer import StateReceiver, StateSender
from poise.runtime.migration.step_taker import StepTaker
from poise.threads import poll_until
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.records.migration_records import MigrationPhases, Role, Step

_PAUSE_SHARE = 0.8
"""A pause may take this share of its time, so that targets learn why they get no state
before they give up."""


class Participant:
    """One incarnation's part in one migration; any thread may use it."""

    def __init__(
        self, runner: Runner, role: Role, migration: int, server: ConnectionServer
    ) -> None:
        self.migration = migration
        self.phases = MigrationPhases(role, f"component '{runner.spec.name}'")
        self._runner = runner
        self._server = server
        self._sender: StateSender | None = None
        self._receiver: StateReceiver | None = None

    def run(self, step: Step, deadline: float) -> None:  # noqa: C901, a table
        """Take a step until `deadline` [s, monotonic clock]."""
        runner = self._runner
        match step.name:
            case "offer state":
                self.close()
                self._sender = StateSender(runner, self.migration, self._server)
            case "pre-copy":
                self.close()
                with as_usual():  # a large state takes its time, and nobody waits
                    self._receiver = StateReceiver(
                        runner, step.sources, self.migration, self._server.folder
                    )
                    self._receiver.connect(deadline)
            case "request state":
                self._receiving().request()
            case "await idle":
                self._sending().wait_requested(_left(deadline))
                runner.gate.wait_idle(min(step.limit, _left(deadline)))
            case "pause":
                self._pause(step.lossy, _left(deadline))
            case "drain mailbox":
                text = "did not handle all messages that wait"
                text = f"component '{runner.spec.name}' {text}"
                poll_until(runner.endpoints.mailbox.is_empty, deadline, text)
            case "send state":
                self._sending().send()
            case "restore state":
                self._receiving().restore(_left(deadline))
            case "activate":
                self._activate(_left(deadline))
            case "redirect":
                runner.exclusion.redirect()
            case "resume" | "roll back":
                runner.aim("active")
                self._refuse("it is at work again")

    def close(self) -> None:
        """Transfer nothing any more; harmless when repeated."""
        if self._sender is not None:
            self._sender.close()
        if self._receiver is not None:
            self._receiver.close()
        self._sender = self._receiver = None

    def _sending(self) -> StateSender:
        if self._sender is None:
            raise RunError(f"component '{self._runner.spec.name}' offers no state")
        return self._sender

    def _receiving(self) -> StateReceiver:
        if self._receiver is None:
            raise RunError(f"component '{self._runner.spec.name}' receives no state")
        return self._receiver

    def _refuse(self, reason: str) -> None:
        """Tell targets, if there are any, why they get no state."""
        if self._sender is not None:
            self._sender.refuse(reason)

    def _pause(self, lossy: Collection[str], limit: float) -> None:
        senders = list(self._runner.endpoints.senders.values())
        for sender in senders:
            for key, route in sender.routes().items():
                if key in lossy:  # the component itself may be sending there
                    route.give_up()
        try:
            self._runner.gate.pause_for_migration(_PAUSE_SHARE * limit)
        except PoiseError as error:
            self._refuse(str(error))
            raise
        for sender in senders:
            if sender.routes().keys().isdisjoint(lossy):
                sender.send_marker(self.migration)

    def _activate(self, limit: float) -> None:
        runner = self._runner
        runner.aim("ready")
        if runner.life_cycle.wait_state({"active", "failed"}, limit) != "active":
            late = f"`activate` has not ended after {limit:.3g} s"
            if limit == 0:  # the steps before took it all
                late = "no time was left for `activate`"
            error = runner.status().error or late
            raise RunError(f"component '{runner.spec.name}' is not activated: {error}")


def _left(deadline: float) -> float:
    return max(0.0, deadline - time.monotonic())


class MigrationExecutor(StepTaker):
    """Takes steps in a real container."""

    def __init__(
        self, runners: Runners, wiring: Wiring, server: ConnectionServer
    ) -> None:
        super().__init__(time.monotonic)
        self._runners = runners
        self._wiring = wiring
        self._server = server
        self._participants: dict[Runner, Participant] = {}

    def forget(self, runner: Runner) -> None:
        """Know no more of an incarnation that has ended."""
        if runner in self._participants:
            self._participants.pop(runner).close()

    def _carry_out(self, step: Step, migration: int, deadline: float) -> None:
        try:
            self._act(step, migration, deadline)
        except PoiseError:
            raise
        except BaseException as error:  # a user's restore may raise anything
            raise RunError(f"'{step.name}': {brief_traceback(error)}") from error

    def _act(self, step: Step, migration: int, deadline: float) -> None:
        match step.name:
            case "buffer":
                self._buffer(step, migration)
            case "release to targets" | "release to sources":
                for key in step.keys:
                    self._wiring.sender_by_key(key).switch(key)
                for key in step.keys:
                    sender = self._wiring.sender_by_key(key)
                    text = f"connector {sender.name}: a call has no answer yet from "
                    text += "the computer that its target left"
                    poll_until(sender.has_left, deadline, text)
            case "drain channels":
                runner = self._runner(step)
                marked = self._wiring.with_messages(step.connectors, runner)
                markers = dict.fromkeys(marked, migration)
                for key in step.lossy:
                    self._wiring.shut(key)
                runner.endpoints.wait_markers(markers, _left(deadline))
            case "pre-copy":
                self._check_ports(step)
        if step.role is not None:
            participant = self._participant(self._runner(step), step.role, migration)
            with participant.phases.taking(step.name, step.phase):
                participant.run(step, deadline)

    def _check_ports(self, step: Step) -> None:
        """Raise PoiseError when a target does not fit its connectors."""
        self._wiring.raise_on_trouble(step.component, step.epoch)
        epoch, _ = step.sources.get(step.component, (step.epoch, ""))
        before = self._runners.get((step.component, epoch))
        if before is not None:  # it moves within the container: its code is replaced
            check_ports(step.component, before.ports, self._runner(step).ports)

    def _buffer(self, step: Step, migration: int) -> None:
        for name in step.connectors:
            sender = self._wiring.sender(name)
            sender.buffer_for_move()
            sender.send_marker(migration)
        for key, keep in step.lossy.items():
            sender = self._wiring.sender_by_key(key)
            sender.buffer_for_move(keep)
            if route := sender.routes().get(key):
                route.give_up()

    def _runner(self, step: Step) -> Runner:
        try:
            return self._runners[step.component, step.epoch]
        except KeyError:
            text = f"component '{step.component}' ({step.epoch}) does not run here"
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


def check_ports(
    component: str, before: Mapping[str, Port], after: Mapping[str, Port]
) -> None:
    """Raise UsageError when other code has a port of another type, or not joined."""
    for name, port in after.items():
        known = before.get(name)
        end = f"'{component}.{name}' {_shown(port)}"
        if known is not None and (
            known.kind != port.kind or fingerprint(known.type) != fingerprint(port.type)
        ):
            raise UsageError(f"the types differ: {end}, and before {_shown(known)}")
        if known is None and port.kind in {"requires", "subscribes"}:
            raise UsageError(f"{end}, but no connector joins it")


def _shown(port: Port) -> str:
    return f"{port.kind} {getattr(port.type, '__qualname__', port.type)}"
