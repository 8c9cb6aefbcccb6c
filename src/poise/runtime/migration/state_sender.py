"""The source's side of a state transfer, and how its messages cross.

The target requests the state over a channel of their own: first while the source still
works (`Request.STATE`, for components that offer `snapshot_delta`), then everything
(`Request.ALL`), which is answered as soon as the source is paused and drained.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any

from msgspec import Struct

from poise.errors import RunError, Timeout, UsageError
from poise.priority import ahead, first
from poise.runtime.component.component import Component
from poise.runtime.connectors.channel_route import entry_codec
from poise.runtime.execution.exclusion import new_chain
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration.state_check import (
    check_fits,
    check_restores,
    describe_type,
    type_taken_by,
)
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections.channel import Channel, Pieces
from poise.wire.frame import Frame, Kind

PIECE = 1 << 18
"""Bytes that are sent at a time: calls over the same connection go in between."""
SERVE_LIMIT = 1.0
"""A snapshot waits at most this long for the component's turn [s]."""


class Request(IntEnum):
    """What a target requests."""

    STATE = 1
    ALL = 2


class StateTransfer(Struct, frozen=True, kw_only=True):
    """All that lets the target go on where the source stopped.

    Parameters
    ----------
    state, delta
        Frames with what `snapshot` or `snapshot_delta` gave; empty: nothing.
    state_type
        The type of the state, by `state_check.describe_type`.
    messages
        Ports and frames of the messages and one-way calls that wait, oldest first.
    due
        Timer -> time until its next release [s].
    """

    state: bytes = b""
    state_type: str = ""
    delta: bytes = b""
    messages: tuple[tuple[str, bytes], ...] = ()
    due: Mapping[str, float] = {}


class Piece(Struct, frozen=True):
    """A part of an encoded state transfer, and the size of the whole [bytes]."""

    size: int
    data: bytes


_TRANSFER = codec(StateTransfer)
_REQUEST = codec(tuple[int, int, float])
_PIECE = codec(Piece)
_ERROR = codec(str)


def key_of(component: str, epoch: int, migration: int) -> str:
    """Return what both sides call the channel from a source in a migration."""
    return f"state/{component}/{epoch}.{migration}"


class StateSender:
    """Serves the state of one source in one migration.

    A request for everything waits until `send` or `refuse` was called.
    """

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._has_sent_state = False
        self._decided = threading.Event()
        self._why_not = ""
        self._encoding = threading.Lock()
        self._state_frame = self._frame = b""

    def send(self) -> None:
        """Answer from now on: the component is paused, and its channels are drained."""
        self._why_not = ""
        self._decided.set()

    def refuse(self, reason: str) -> None:
        """Answer with the reason why no state is sent."""
        self._why_not = reason
        self._decided.set()

    def handle(self, received: Frame) -> Pieces:
        """Answer a target; a component's error crosses as text."""
        try:
            request, offset, limit = received.value(_REQUEST)
            with self._encoding:
                data = self._answer(Request(request), offset, limit)
            piece = Piece(len(data), data[offset : offset + PIECE])
            return frame.segments(_PIECE, piece, Kind.RESULT)
        except Exception as error:  # noqa: BLE001, a user's snapshot may raise anything
            text = f"{type(error).__qualname__}: {error}"
            return frame.segments(_ERROR, text, Kind.ERROR)

    def _answer(self, request: Request, offset: int, limit: float) -> bytes:
        """Return the encoded state, which is taken at the first request."""
        if request is Request.STATE:
            if not offset:
                self._state_frame = _encoded(self._state())
            return self._state_frame
        with first():
            is_decided = self._decided.wait(limit)
        if not is_decided:
            raise Timeout(f"component '{self._runner.spec.name}' is not ready to send")
        if self._why_not:
            raise RunError(self._why_not)
        if not self._frame:
            self._state_frame = b""
            with ahead():  # users' code
                self._frame = _encoded(self._all())
        return self._frame

    def _state(self) -> StateTransfer:
        chain = new_chain()
        self._runner.exclusion.enter(chain, SERVE_LIMIT)
        try:
            state = self._runner.component.snapshot()
        finally:
            self._runner.exclusion.leave()
        self._has_sent_state = True
        return StateTransfer(state=_frame_of(state), state_type=_type_of(state))

    def _all(self) -> StateTransfer:
        runner = self._runner
        state = delta = b""
        state_type = ""
        with runner.gate.borrowed():
            if self._has_sent_state:
                delta = _frame_of(runner.component.snapshot_delta())
            else:
                taken = runner.component.snapshot()
                state, state_type = _frame_of(taken), _type_of(taken)
            messages = tuple(_messages(runner))
        now = runner.clock.now()
        return StateTransfer(
            state=state,
            state_type=state_type,
            delta=delta,
            messages=messages,
            due=runner.timers.left(now),
        )


def _encoded(transfer: StateTransfer) -> bytes:
    return b"".join(frame.segments(_TRANSFER, transfer, Kind.RESULT))


def fetch(channel: Channel, request: Request, limit: float) -> StateTransfer:
    """Request the state of a source.

    Raises
    ------
    UsageError
        Its component could not give its state.
    CallError
        It did not answer within `limit` [s].
    """
    deadline = time.monotonic() + limit
    data = bytearray()
    size = 1
    while len(data) < size:
        left = deadline - time.monotonic()
        if left <= 0:
            raise Timeout(f"{len(data)} of {size} B of the state came in {limit:g} s")
        pieces = frame.segments(_REQUEST, (request, len(data), left), Kind.CALL)
        answer = channel.request(pieces, left)
        if answer.kind is Kind.ERROR:
            text = answer.value(_ERROR)
            raise UsageError(f"the state could not be taken: {text}")
        piece = answer.value(_PIECE)
        data += piece.data
        size = piece.size
    transfer: StateTransfer = frame.parse(data).value(_TRANSFER)
    return transfer


def offers_delta(component: Component) -> bool:
    """Whether the state can be sent while the component still works."""
    return type(component).snapshot_delta is not Component.snapshot_delta


def restore(
    runner: Runner, transfer: StateTransfer, adapt: Callable[[Any], Any] | None = None
) -> None:
    """Let an inactive target go on from what the source sent just now.

    Parameters
    ----------
    adapt
        Turns the state of another implementation into one for this; its parameter's
        annotation says the type that it takes.

    Raises
    ------
    Exception
        Whatever the component's `restore` raises; it must not be activated then.
    """
    component = runner.component
    now = runner.clock.now()
    runner.timers.begin_at({name: now + left for name, left in transfer.due.items()})
    with runner.gate.borrowed():
        if transfer.state and not runner.spec.fresh:
            check_restores(component)
            method = adapt or component.restore
            taken = type_taken_by(method)
            check_fits(transfer.state_type, taken, method.__qualname__)
            state = _value_of(transfer.state, method)
            component.restore(adapt(state) if adapt else state)
        if transfer.delta and not runner.spec.fresh:
            delta = _value_of(transfer.delta, component.restore_delta)
            component.restore_delta(delta)
    for port, data in transfer.messages:
        received = frame.parse(data)
        value = received.value(entry_codec(runner.ports[port], received.tag))
        runner.endpoints.preload(port, (received.tag, value))


def warm_up(runner: Runner) -> None:
    """Look up types and codecs before the pause, for `restore`."""
    for method in (runner.component.restore, runner.component.restore_delta):
        codec(type_taken_by(method))
    describe_type(type_taken_by(runner.component.restore))


def _messages(runner: Runner) -> list[tuple[str, bytes]]:
    frames = []
    for name, inbox in runner.endpoints.inboxes.items():
        for tag, value in inbox.waiting():
            coder = entry_codec(runner.ports[name], tag)
            pieces = frame.segments(coder, value, Kind.MESSAGE, tag=tag)
            frames.append((name, b"".join(pieces)))
    return frames


def _type_of(state: Struct | None) -> str:
    return "" if state is None else describe_type(type(state))


def _frame_of(state: Struct | None) -> bytes:
    if state is None:
        return b""
    return b"".join(frame.segments(codec(type(state)), state, Kind.MESSAGE))


def _value_of(data: bytes, method: Any) -> Any:  # noqa: ANN401, a user's method
    return frame.parse(data).value(codec(type_taken_by(method)))


def check_state(component: type[Component]) -> None:
    """Raise UsageError when what `restore` takes has no type."""
    for name in ("restore", "restore_delta"):
        method = getattr(component, name)
        if method is not getattr(Component, name):
            type_taken_by(method.__get__(component))
