"""How the state goes from the source of a move to its target.

The target requests it, as a call: first while the source works (`Request.STATE`, for
components that offer `snapshot_delta`), then everything, which is answered once the
source is paused and drained. When an architecture is replaced, a function of the
user's, `adapt`, makes the new states from the old ones: fields of two messages.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from enum import IntEnum
from pathlib import Path
from typing import Any, get_type_hints

import msgspec
from msgspec import Struct

from poise import threads
from poise.clock import Stamp
from poise.errors import RunError, Timeout, UsageError, said
from poise.priority import before_components, going_first
from poise.runtime.component.implementation import find_function
from poise.runtime.connectors.channel_route import entry_codec
from poise.runtime.connectors.latest import Heard
from poise.runtime.execution.container_lease import check_lease
from poise.runtime.execution.data_age import Stamped
from poise.runtime.execution.exclusion import new_chain
from poise.runtime.hosting.output import writing_as
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
from poise.threads import poll_until
from poise.wire import frame
from poise.wire.address import Address
from poise.wire.codec import Codec, WireError, codec
from poise.wire.connections.channel import Channel
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.frame import Frame, FrameKind, Pieces
from poise.wire.records.status_records import ActionEnd, TaskRequest

SERVE_LIMIT = 1.0
"""A snapshot waits at most this long for the component's turn [s]."""

REQUEST: Codec[tuple[int, float]] = codec(tuple[int, float])
"""What is requested, and how long the target waits [s]."""
CONNECT_LIMIT = 1.5
"""A source that does not offer its state within this time is gone [s]."""
REQUEST_LIMIT = 5.0
"""Sources answer within this time after the request [s]: the pause is about to begin,
and is shorter."""


class Request(IntEnum):
    """What a target requests."""

    STATE = 1
    ALL = 2
    REST = 3  # All but the state: the target begins without one


class StateTransfer(Struct, frozen=True, kw_only=True):
    """All that lets the target go on where the source stopped."""

    # Frames with what `snapshot` or `snapshot_delta` gave; empty: nothing
    state: bytes = b""
    state_type: str = ""  # The type of the state, by `state_check.describe_type`
    delta: bytes = b""
    # Ports, frames and stamps of the messages and one-way calls that wait, oldest first
    messages: tuple[tuple[str, bytes, Mapping[str, Stamp]], ...] = ()
    due: Mapping[str, float] = {}  # Timer -> time until its next release [s]
    # Chain -> the stamp of the data that the source took last
    stamps: Mapping[str, Stamp] = {}
    heard: Mapping[str, Heard] = {}  # By port
    latest: Mapping[str, bytes] = {}  # Port -> its last message as a frame
    # Parameters that were set a moment ago: no deployment says so yet
    parameters: Mapping[str, Any] = {}
    begun: tuple[int, ...] = ()  # The actions that the source was told of
    # What it said of tasks: the manager may not have heard it yet
    ended: tuple[ActionEnd, ...] = ()
    requests: tuple[TaskRequest, ...] = ()


TRANSFER: Codec[StateTransfer] = codec(StateTransfer)


def key_of(component: str, epoch: int, migration: int) -> str:
    """Return what both sides call the channel from a source in a migration."""
    return f"state/{component}/{epoch}.{migration}"


class StateSender:
    """Serves the state of one source in one migration; `ALL` waits for the snapshot."""

    def __init__(
        self, runner: Runner, migration: int, server: ConnectionServer
    ) -> None:
        self._runner = runner
        self._server = server
        self._key = key_of(runner.spec.name, runner.spec.epoch, migration)
        self._has_sent_state = False
        self._requested, self._decided = threading.Event(), threading.Event()
        self._why_not = ""
        self._serving = threading.Lock()
        self._taken: StateTransfer | None = None
        server.open(self._key, self._serve)

    def wait_requested(self, limit: float) -> None:
        """Wait up to `limit` [s] until the target has requested everything."""
        if not self._requested.wait(limit):
            state = f"the state of component '{self._runner.spec.name}'"
            if self._has_sent_state:
                text = f"{state} was not copied ahead within {limit:.3g} s"
                raise Timeout(f"{text}: is it too large for the link?")
            raise Timeout(f"no target requested {state} within {limit:.3g} s")

    def send(self) -> None:
        """Answer from now on: the component is paused, and its channels are drained."""
        self._why_not = ""
        self._decided.set()

    def refuse(self, reason: str) -> None:
        """Answer with the reason why no state is sent, and keep none."""
        self._why_not, self._taken = reason, None
        self._decided.set()

    def close(self) -> None:
        """Serve no more."""
        self.refuse("the offer is withdrawn")
        self._server.shut(self._key)

    def _serve(self, received: Frame) -> Pieces:
        """Answer a target; a component's error crosses as text."""
        try:
            request, limit = received.value(REQUEST)
            with self._serving, writing_as(self._runner.spec.name):
                if request == Request.STATE:
                    transfer = self._state()
                else:
                    self._requested.set()
                    self._wait_decided(limit)
                    # a request whose answer got lost gets the same delta again
                    transfer = self._taken = self._taken or self._all(request)
                # a snapshot may take long
                check_lease(self._runner.lease, self._runner.spec.name)
                return frame.segments(TRANSFER, transfer, FrameKind.RESULT)
        # a user's snapshot may raise anything
        except BaseException as error:  # noqa: BLE001
            return frame.failure(type(error).__qualname__, said(error))

    def _state(self) -> StateTransfer:
        self._runner.exclusion.enter(new_chain(), SERVE_LIMIT)
        try:
            state = self._runner.component.snapshot()
            # of other code all is sent in the end: what changed, it does not know
            self._has_sent_state = self._runner.copies_ahead
            self._runner.owes_changes = self._has_sent_state
        finally:
            self._runner.exclusion.leave()
        return _transfer(state)

    def _wait_decided(self, limit: float) -> None:
        with going_first():
            is_decided = self._decided.wait(limit)
        if not is_decided:
            name = self._runner.spec.name
            raise Timeout(f"component '{name}' is not ready to send")
        if self._why_not:
            raise RunError(self._why_not)

    def _all(self, request: int) -> StateTransfer:
        runner = self._runner
        with before_components(), runner.gate.borrowed():  # users' code
            if request == Request.REST:
                transfer = StateTransfer()
            elif self._has_sent_state:
                delta = _frame_of(runner.component.snapshot_delta())
                transfer = StateTransfer(delta=delta)
            else:
                transfer = _transfer(runner.component.snapshot())
            messages = tuple(_messages(runner))
        due = runner.timers.left(runner.clock.now())
        return msgspec.structs.replace(
            transfer,
            messages=messages,
            due=due,
            stamps=runner.ages.held(),
            heard=runner.endpoints.heard,
            latest=runner.endpoints.latest.to_frames(),
            parameters=dict(runner.parameters_set),
            begun=tuple(runner.begun),
            ended=runner.news.ended(),
            requests=runner.news.requests(),
        )


def _transfer(state: Struct | None) -> StateTransfer:
    if state is None:
        return StateTransfer()
    return StateTransfer(state=_frame_of(state), state_type=describe_type(type(state)))


def _messages(runner: Runner) -> Iterator[tuple[str, bytes, Mapping[str, Stamp]]]:
    for name, (tag, entry) in runner.endpoints.mailbox.waiting():
        coder = entry_codec(runner.ports[name], tag)
        value, stamps = entry, {}
        if type(entry) is Stamped:
            value = entry.value
            times = map(runner.clock.stamp, entry.stamps)
            stamps = dict(zip(entry.chains, times, strict=True))
        pieces = frame.segments(coder, value, FrameKind.MESSAGE, tag=tag)
        yield name, b"".join(pieces), stamps


def _frame_of(state: Struct | None) -> bytes:
    if state is None:
        return b""
    return b"".join(frame.segments(codec(type(state)), state, FrameKind.MESSAGE))


class StateReceiver:
    """Restores the state of one target in one migration."""

    def __init__(
        self,
        runner: Runner,
        sources: Mapping[str, tuple[int, str]],
        migration: int,
        folder: Path,
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
            key = key_of(name, epoch, migration)
            self._channels[name] = Channel(key, Address.parse(address), folder)
        self._requested: dict[str, Future[StateTransfer]] = {}

    def connect(self, deadline: float) -> None:
        """Connect to the sources; fetch a large state while they still work."""
        give_up_at = min(deadline, time.monotonic() + CONNECT_LIMIT)
        for name, channel in self._channels.items():
            late = f"component '{name}' ({self._sources[name][0]}) is not reached"
            try:
                poll_until(channel.try_connect, give_up_at, late)
            except Timeout as error:
                if not channel.refusal:
                    raise
                raise Timeout(f"{late}: {channel.refusal}") from error
        is_fresh = self._runner.spec.fresh
        if self._is_same and self._runner.copies_ahead and not is_fresh:
            left = max(0.0, deadline - time.monotonic())
            (channel,) = self._channels.values()
            restore(self._runner, fetch(channel, Request.STATE, left), self._adapt)

    def request(self) -> None:
        """Request everything, on threads that only wait, before the sources pause."""
        component = self._runner.component
        request = Request.REST if self._runner.spec.fresh else Request.ALL
        for method in (component.restore, component.restore_delta):
            codec(type_taken_by(method))  # looked up before the pause
        describe_type(type_taken_by(component.restore))
        for name, channel in self._channels.items():
            requested = self._requested[name] = Future()
            with going_first():
                threads.daemon(
                    _fetch_all, "receiver", channel, requested, request
                ).start()

    def restore(self, limit: float) -> None:
        """Restore the state within `limit` [s], as soon as the sources send it."""
        deadline = time.monotonic() + limit
        transfers = {}
        for name, requested in self._requested.items():
            left = max(0.0, deadline - time.monotonic())
            try:
                transfers[name] = requested.result(left)
            except TimeoutError:
                text = f"component '{name}' sent no state within {limit:.3g} s"
                raise Timeout(text) from None
        with before_components():  # users' code
            if self._is_same:
                (transfer,) = transfers.values()
                restore(self._runner, transfer, self._adapt)
            elif self._adapt is not None and transfers:
                self._restore_adapted(self._adapt, transfers)
        self.close()

    def close(self) -> None:
        """End the transfer; harmless when repeated."""
        self._requested.clear()
        with contextlib.suppress(KeyError):  # two threads may end it at once
            while True:
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
        after = _adapted(adapt, type_taken_by(adapt)(**states))
        with runner.gate.borrowed(), writing_as(runner.spec.name):
            runner.component.restore(getattr(after, runner.spec.name))


def fetch(channel: Channel, request: Request, limit: float) -> StateTransfer:
    """Request the state of a source; CallError: no answer within `limit` [s]."""
    pieces = frame.segments(REQUEST, (request, limit), FrameKind.CALL)
    answer = channel.request(pieces, limit)
    if answer.kind is FrameKind.ERROR:
        type_name, text, _ = answer.value(frame.FAILURE)
        raise UsageError(f"the snapshot failed: {type_name}: {text}")
    transfer: StateTransfer = answer.value(TRANSFER)
    return transfer


def _fetch_all(
    channel: Channel, requested: Future[StateTransfer], request: Request
) -> None:
    try:
        requested.set_result(fetch(channel, request, REQUEST_LIMIT))
    except Exception as error:  # noqa: BLE001, `restore` raises it
        requested.set_exception(error)


def restore(
    runner: Runner, transfer: StateTransfer, adapt: Callable[[Any], Any] | None = None
) -> None:
    """Let an inactive target go on from what the source sent just now."""
    component, is_fresh = runner.component, runner.spec.fresh
    now = runner.clock.now()
    runner.timers.begin_at({name: now + left for name, left in transfer.due.items()})
    with runner.gate.borrowed(), writing_as(runner.spec.name):
        if transfer.state and not is_fresh:
            check_restores(component)
            method = adapt or component.restore
            check_fits(transfer.state_type, type_taken_by(method), method.__qualname__)
            state = _value_of(transfer.state, method)
            component.restore(_adapted(adapt, state) if adapt else state)
        if transfer.delta and not is_fresh:
            delta = _value_of(transfer.delta, component.restore_delta)
            component.restore_delta(delta)
    if not is_fresh:
        runner.begun = set(transfer.begun)
    runner.news.take_over(transfer.ended, transfer.requests)
    runner.ages.restore(transfer.stamps)
    if adapt is None:
        runner.hand_parameters(transfer.parameters)
    if transfer.latest and not is_fresh:
        runner.endpoints.buffer_until_active()  # the source may yet go on
        runner.endpoints.latest.restore(transfer.latest)
    # what starts without its state needs the last messages again, but for those that
    # it is handed here
    has_state = transfer.state or transfer.delta or runner.copies_ahead
    waiting = {port for port, _, _ in transfer.messages}
    known = runner.endpoints.heard  # other code may lack a port
    for port in transfer.heard.keys() & known:
        if port in waiting or (has_state and not is_fresh):
            known[port].update(transfer.heard[port])
    for port, data, stamps in transfer.messages:
        received = frame.parse(data)
        value = received.value(entry_codec(runner.ports[port], received.tag))
        if stamps:
            times = tuple(map(runner.ages.local, stamps.values()))
            value = Stamped(tuple(stamps), times, value)
        runner.endpoints.mailbox.preload(port, (received.tag, value))


def _value_of(data: bytes, method: Any) -> Any:  # noqa: ANN401, a user's method
    return frame.parse(data).value(codec(type_taken_by(method)))


def _adapted(adapt: Callable[[Any], Any], state: Any) -> Any:  # noqa: ANN401, a user's function
    """Return what a function makes of a state; UsageError: not what it says it does."""
    made = frame.segments(codec(Any), adapt(state), FrameKind.MESSAGE)
    declared = codec(get_type_hints(adapt)["return"])
    try:
        return frame.parse(b"".join(made)).value(declared)
    except WireError as error:
        raise UsageError(f"what {adapt.__qualname__} returned is {error}") from None
