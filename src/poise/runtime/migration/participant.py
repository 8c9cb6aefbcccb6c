"""One incarnation's part in one migration, as source or target."""

from __future__ import annotations

import time
from collections.abc import Collection

from poise.errors import PoiseError, RunError
from poise.priority import as_usual
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration.state_receiver import StateReceiver
from poise.runtime.migration.state_sender import StateSender
from poise.runtime.waker import poll_until
from poise.wire.address import Address
from poise.wire.connections.channel import Channel
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

    def take(self, step: Step, deadline: float) -> None:  # noqa: C901, a table
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
                        runner, step.sources, self.migration, self._channel
                    )
                    self._receiver.connect(deadline)
            case "request state":
                self._receiving().request()
            case "await idle":
                runner.gate.wait_idle(min(step.limit, _left(deadline)))
            case "pause":
                self._pause(step.late, _left(deadline))
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

    def _channel(self, key: str, address: str) -> Channel:
        return Channel(key, Address.parse(address), self._server.folder)

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

    def _pause(self, late: Collection[str], limit: float) -> None:
        senders = list(self._runner.endpoints.senders.values())
        for sender in senders:
            for key, route in sender.routes().items():
                if key in late:  # the component itself may be sending there
                    route.give_up()
        try:
            self._runner.gate.pause_for_migration(_PAUSE_SHARE * limit)
        except PoiseError as error:
            self._refuse(str(error))
            raise
        for sender in senders:
            if sender.routes().keys().isdisjoint(late):
                sender.send_marker(self.migration)

    def _activate(self, limit: float) -> None:
        runner = self._runner
        runner.aim("ready")
        if runner.life_cycle.wait_state({"active", "failed"}, limit) != "active":
            error = runner.status().error or f"waited {limit:g} s"
            raise RunError(f"component '{runner.spec.name}' is not activated: {error}")


def _left(deadline: float) -> float:
    return max(0.0, deadline - time.monotonic())
