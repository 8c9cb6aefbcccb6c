"""The target's side of a state transfer.

From a source of the same component it takes everything. When a whole architecture is
replaced by its alternative, a function of the user's, `adapt`, makes the states of the
new components from those of the old ones, by their names::

    class Before(Message):
        odometry: Odometry      # the state of the component `odometry`

    class After(Message):
        slam: Map               # what the component `slam` is to restore

    def adapt(before: Before) -> After: ...

It is run for every component in `After`, and asks for the states in `Before` alone.
"""

from __future__ import annotations

import inspect
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, get_type_hints

import msgspec

from poise.errors import Timeout, UsageError
from poise.priority import ahead, first
from poise.runtime.component.implementation import find_function
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration import state_sender
from poise.runtime.migration.state_check import (
    check_adapted,
    check_fits,
    check_result,
)
from poise.runtime.migration.state_sender import Request, StateTransfer
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections.channel import Channel
from poise.wire.records.migration import PreCopy

_POLL = 0.001
"""While a source is not connected, look this often [s]."""

CONNECT_LIMIT = 3.0
"""A source that does not offer its state within this time is gone [s]."""

REQUEST_LIMIT = 5.0
"""Sources answer within this time after the request [s]: the pause is about to begin,
and is shorter."""

OpenChannel = Callable[[str, str], Channel]
"""Opens a channel by its key and the address of a container."""


class StateReceiver:
    """Restores the state of one target in one migration.

    Raises
    ------
    RobotError, UsageError
        `adapt` cannot be found, or does not say what it takes and gives.
    """

    def __init__(
        self, runner: Runner, step: PreCopy, migration: int, open_channel: OpenChannel
    ) -> None:
        self._runner = runner
        self._step = step
        self._migration = migration
        name, adapt = runner.spec.name, runner.spec.adapt
        self._adapt = find_function(adapt) if adapt else None
        self._is_same = name in step.sources
        self._before: Mapping[str, Any] = {}
        if self._adapt is not None and self._is_same:
            check_result(self._adapt, runner.component)
        elif self._adapt is not None:
            before, after = states = types_of(self._adapt)
            check_adapted(runner.component, name, states, step.sources)
            self._before = before if name in after else {}
        self._open_channel = open_channel
        self._channels: dict[str, Channel] = {}
        self._requested: dict[str, Future[StateTransfer]] = {}

    def connect(self, deadline: float) -> None:
        """Connect to the sources; fetch a large state while they still work.

        Raises
        ------
        Timeout
            A source could not be reached until `deadline` [s, monotonic clock].
        """
        sources = self._step.sources
        for name in self._needed():
            key = state_sender.key_of(name, sources[name], self._migration)
            address = self._step.addresses[name]
            self._channels[name] = self._open_channel(key, address)
        give_up_at = min(deadline, time.monotonic() + CONNECT_LIMIT)
        for name, channel in self._channels.items():
            while not channel.is_ready():
                if time.monotonic() > give_up_at:
                    raise Timeout(
                        f"component '{name}' ({sources[name]}) is not reached"
                    )
                time.sleep(_POLL)
        if self._is_same and state_sender.offers_delta(self._runner.component):
            left = max(0.0, deadline - time.monotonic())
            channel = self._channels[self._runner.spec.name]
            self._restore_same(state_sender.fetch(channel, Request.STATE, left))

    def request(self) -> None:
        """Request everything, so that the requests are there when the sources pause.

        On threads of their own, which only wait.
        """
        state_sender.warm_up(self._runner)
        for name, channel in self._channels.items():
            requested: Future[StateTransfer] = Future()
            self._requested[name] = requested
            with first():
                threading.Thread(
                    target=_fetch,
                    args=(channel, requested),
                    name="receiver",
                    daemon=True,
                ).start()

    def restore(self, limit: float) -> None:
        """Restore the state within `limit` [s], as soon as the sources send it.

        Raises
        ------
        Exception
            A source cannot send, or whatever `adapt` and `restore` raise.
        """
        deadline = time.monotonic() + limit
        transfers = {}
        for name, requested in self._requested.items():
            try:
                transfers[name] = requested.result(
                    max(0.0, deadline - time.monotonic())
                )
            except TimeoutError:
                text = f"component '{name}' sent no state within {limit:g} s"
                raise Timeout(text) from None
        with ahead():  # users' code
            if self._is_same:
                self._restore_same(transfers[self._runner.spec.name])
            else:
                self._restore_adapted(transfers)
        self.close()

    def close(self) -> None:
        """End the transfer; harmless when repeated."""
        self._requested.clear()
        while self._channels:
            self._channels.popitem()[1].close()

    def _needed(self) -> set[str]:
        if self._is_same:
            return {self._runner.spec.name}
        return set(self._before)

    def _restore_same(self, transfer: StateTransfer) -> None:
        state_sender.restore(self._runner, transfer, self._adapt)

    def _restore_adapted(self, transfers: Mapping[str, StateTransfer]) -> None:
        """Restore what `adapt` makes of the states of other components."""
        runner = self._runner
        if self._adapt is None or not self._before:
            return
        for name, type_ in self._before.items():
            if transfers[name].state:
                described = transfers[name].state_type
                check_fits(described, type_, f"--adapt for '{name}'")
        states = {
            name: frame.parse(transfers[name].state).value(codec(type_))
            for name, type_ in self._before.items()
            if transfers[name].state
        }
        (parameter,) = _hints(self._adapt)[0]
        after = self._adapt(parameter(**states))
        with runner.gate.borrowed():
            runner.component.restore(getattr(after, runner.spec.name))


def _fetch(channel: Channel, requested: Future[StateTransfer]) -> None:
    try:
        requested.set_result(state_sender.fetch(channel, Request.ALL, REQUEST_LIMIT))
    except Exception as error:  # noqa: BLE001, `restore` raises it
        requested.set_exception(error)


def types_of(
    adapt: Callable[[Any], Any],
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return which states a function takes, and which it gives: component -> type.

    Raises
    ------
    UsageError
        Its parameter or its result is not annotated with a message class.
    """
    parameters, result = _hints(adapt)
    found = []
    for type_ in (*parameters, result):
        if not (isinstance(type_, type) and issubclass(type_, msgspec.Struct)):
            raise UsageError(
                f"{adapt.__qualname__}: its parameter and its result must be message "
                "classes with a field for each component whose state it takes or gives"
            )
        fields = msgspec.structs.fields(type_)
        hints = get_type_hints(type_)
        found.append({field.name: hints[field.name] for field in fields})
    if len(found) != 2:  # noqa: PLR2004, one in, one out
        raise UsageError(f"{adapt.__qualname__} must take one argument: the old states")
    return found[0], found[1]


def _hints(adapt: Callable[[Any], Any]) -> tuple[tuple[Any, ...], Any]:
    hints = get_type_hints(adapt)
    names = tuple(inspect.signature(adapt).parameters)
    return tuple(hints.get(name) for name in names), hints.get("return")
