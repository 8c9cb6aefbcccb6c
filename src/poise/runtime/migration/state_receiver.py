"""The target's side of a state transfer.

When an architecture is replaced, a function of the user's, `adapt`, makes the states of
the new components from those of the old ones, which are the fields of two messages::

    def adapt(before: Before) -> After: ...

It is run for every component in `After`, and asks for the states in `Before` alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

from poise import threads
from poise.errors import Timeout, UsageError
from poise.priority import ahead, first
from poise.runtime.component.component import Component
from poise.runtime.component.implementation import find_function
from poise.runtime.connectors.channel_route import entry_codec
from poise.runtime.execution.data_age import Stamped
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration.state_check import (
    check_adapted,
    check_fits,
    check_restores,
    check_result,
    describe_type,
    type_taken_by,
    types_of,
)
from poise.runtime.migration.state_sender import (
    REQUEST,
    TRANSFER,
    Request,
    StateTransfer,
    key_of,
)
from poise.runtime.waker import poll_until
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections.channel import Channel
from poise.wire.frame import Kind

CONNECT_LIMIT = 1.5
"""A source that does not offer its state within this time is gone [s]."""

REQUEST_LIMIT = 5.0
"""Sources answer within this time after the request [s]: the pause is about to begin,
and is shorter."""

OpenChannel = Callable[[str, str], Channel]
"""Opens a channel by its key and the address of a container."""


class StateReceiver:
    """Restores the state of one target in one migration."""

    def __init__(
        self,
        runner: Runner,
        sources: Mapping[str, tuple[int, str]],
        migration: int,
        open_channel: OpenChannel,
    ) -> None:
        self._runner = runner
        self._sources = sources
        name, adapt = runner.spec.name, runner.spec.adapt
        self._adapt = find_function(adapt) if adapt else None
        self._is_same = name in sources
        # component -> the type of its state, where `adapt` needs it
        self._before: Mapping[str, Any] = {name: None} if self._is_same else {}
        if self._adapt is not None and self._is_same:
            check_result(self._adapt, runner.component)
        elif self._adapt is not None:
            before, after = states = types_of(self._adapt)
            check_adapted(runner.component, name, states, sources)
            self._before = before if name in after else {}
        self._channels: dict[str, Channel] = {}
        for name in self._before:
            epoch, address = sources[name]
            self._channels[name] = open_channel(key_of(name, epoch, migration), address)
        self._requested: dict[str, Future[StateTransfer]] = {}

    def connect(self, deadline: float) -> None:
        """Connect to the sources; fetch a large state while they still work."""
        give_up_at = min(deadline, time.monotonic() + CONNECT_LIMIT)
        for name, channel in self._channels.items():
            late = f"component '{name}' ({self._sources[name][0]}) is not reached"
            poll_until(channel.is_ready, give_up_at, late)
        code = type(self._runner.component)
        has_delta = code.snapshot_delta is not Component.snapshot_delta
        if self._is_same and has_delta:
            left = max(0.0, deadline - time.monotonic())
            (channel,) = self._channels.values()
            restore(self._runner, fetch(channel, Request.STATE, left), self._adapt)

    def request(self) -> None:
        """Request everything, on threads that only wait, before the sources pause."""
        component = self._runner.component
        for method in (component.restore, component.restore_delta):
            codec(type_taken_by(method))  # looked up before the pause
        describe_type(type_taken_by(component.restore))
        for name, channel in self._channels.items():
            requested = self._requested[name] = Future()
            with first():
                threads.daemon(_fetch_all, "receiver", channel, requested).start()

    def restore(self, limit: float) -> None:
        """Restore the state within `limit` [s], as soon as the sources send it."""
        deadline = time.monotonic() + limit
        transfers = {}
        for name, requested in self._requested.items():
            left = max(0.0, deadline - time.monotonic())
            try:
                transfers[name] = requested.result(left)
            except TimeoutError:
                text = f"component '{name}' sent no state within {limit:g} s"
                raise Timeout(text) from None
        with ahead():  # users' code
            if self._is_same:
                (transfer,) = transfers.values()
                restore(self._runner, transfer, self._adapt)
            elif self._adapt is not None and transfers:
                self._restore_adapted(self._adapt, transfers)
        self.close()

    def close(self) -> None:
        """End the transfer; harmless when repeated."""
        self._requested.clear()
        while self._channels:
            self._channels.popitem()[1].close()

    def _restore_adapted(
        self, adapt: Callable[[Any], Any], transfers: Mapping[str, StateTransfer]
    ) -> None:
        """Restore what `adapt` makes of the states of other components."""
        runner, states = self._runner, {}
        for name, transfer in transfers.items():
            if transfer.state:
                type_ = self._before[name]
                check_fits(transfer.state_type, type_, f"--adapt for '{name}'")
                states[name] = frame.parse(transfer.state).value(codec(type_))
        after = adapt(type_taken_by(adapt)(**states))
        with runner.gate.borrowed():
            runner.component.restore(getattr(after, runner.spec.name))


def fetch(channel: Channel, request: Request, limit: float) -> StateTransfer:
    """Request the state of a source; CallError: no answer within `limit` [s]."""
    pieces = frame.segments(REQUEST, (request, limit), Kind.CALL)
    answer = channel.request(pieces, limit)
    if answer.kind is Kind.ERROR:
        type_name, text, _ = answer.value(frame.FAILURE)
        raise UsageError(f"the state could not be taken: {type_name}: {text}")
    transfer: StateTransfer = answer.value(TRANSFER)
    return transfer


def _fetch_all(channel: Channel, requested: Future[StateTransfer]) -> None:
    try:
        requested.set_result(fetch(channel, Request.ALL, REQUEST_LIMIT))
    except Exception as error:  # noqa: BLE001, `restore` raises it
        requested.set_exception(error)


def restore(
    runner: Runner, transfer: StateTransfer, adapt: Callable[[Any], Any] | None = None
) -> None:
    """Let an inactive target go on from what the source sent just now."""
    component, is_fresh = runner.component, runner.spec.fresh
    now = runner.clock.now()
    runner.timers.begin_at({name: now + left for name, left in transfer.due.items()})
    with runner.gate.borrowed():
        if transfer.state and not is_fresh:
            check_restores(component)
            method = adapt or component.restore
            check_fits(transfer.state_type, type_taken_by(method), method.__qualname__)
            state = _value_of(transfer.state, method)
            component.restore(adapt(state) if adapt else state)
        if transfer.delta and not is_fresh:
            delta = _value_of(transfer.delta, component.restore_delta)
            component.restore_delta(delta)
    runner.ages.restore(transfer.stamps)
    for port, data, stamps in transfer.messages:
        received = frame.parse(data)
        value = received.value(entry_codec(runner.ports[port], received.tag))
        if stamps:
            times = tuple(map(runner.ages.local, stamps.values()))
            value = Stamped(tuple(stamps), times, value)
        runner.endpoints.mailbox.preload(port, (received.tag, value))


def _value_of(data: bytes, method: Any) -> Any:  # noqa: ANN401, a user's method
    return frame.parse(data).value(codec(type_taken_by(method)))
