"""What one incarnation of a component hands over to the next, and how it gets there.

The new incarnation asks the old one, over a pipe of their own: first for the state
while the old one still serves (`Ask.STATE`, for components that offer
`snapshot_delta`), then for everything (`Ask.ALL`), which is answered as soon as the old
one is at rest and all that was sent to it has come.
"""

from __future__ import annotations

import inspect
import threading
import time
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, get_type_hints

from msgspec import Struct

from poise.errors import RunError, Timeout, UsageError
from poise.priority import ahead, first
from poise.runtime.component.component import Component
from poise.runtime.connectors.channel_route import entry_codec
from poise.runtime.execution.exclusion import new_chain
from poise.runtime.hosting.runner import Runner
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections.channel import Channel, Pieces
from poise.wire.frame import Frame, Kind

PIECE = 1 << 18
"""So many bytes are sent at a time: other calls over the same link go in between."""
SERVE_LIMIT = 1.0
"""A snapshot waits at most this long to enter the component [s]."""


class Ask(IntEnum):
    """What the new incarnation asks for."""

    STATE = 1
    ALL = 2


class StateTransfer(Struct, frozen=True, kw_only=True):
    """All that makes the next incarnation go on where the last one stopped.

    Parameters
    ----------
    state, delta
        Frames with what `snapshot` or `snapshot_delta` gave; empty: nothing.
    waiting
        Ports and frames of the messages and one-way calls that wait, oldest first.
    due
        Timer -> time until its next release [s].
    """

    state: bytes = b""
    delta: bytes = b""
    waiting: tuple[tuple[str, bytes], ...] = ()
    due: Mapping[str, float] = {}


class Piece(Struct, frozen=True):
    """A part of what is handed over, and the size of the whole [bytes]."""

    size: int
    data: bytes


_HANDOVER = codec(StateTransfer)
_ASK = codec(tuple[int, int, float])
_PIECE = codec(Piece)
_ERROR = codec(str)


def key_of(component: str, epoch: int, number: int) -> str:
    """Return what both sides call the pipe from an old incarnation in an exchange."""
    return f"handover/{component}/{epoch}.{number}"


class StateSender:
    """The old incarnation's side, in one exchange.

    Whoever asks for everything waits until `give` or `refuse` was called.
    """

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._has_given_state = False
        self._decided = threading.Event()
        self._why_not = ""
        self._giving = threading.Lock()
        self._state_frame = self._frame = b""

    def give(self) -> None:
        """Hand over from now on: it is at rest, and all that was sent to it is here."""
        self._why_not = ""
        self._decided.set()

    def refuse(self, reason: str) -> None:
        """Hand over nothing, and tell why."""
        self._why_not = reason
        self._decided.set()

    def handle(self, received: Frame) -> Pieces:
        """Answer a new incarnation; a component's error crosses as text."""
        try:
            ask, offset, limit = received.value(_ASK)
            with self._giving:
                given = self._given(Ask(ask), offset, limit)
            piece = Piece(len(given), given[offset : offset + PIECE])
            return frame.segments(_PIECE, piece, Kind.RESULT)
        except Exception as error:  # noqa: BLE001, a user's snapshot may raise anything
            text = f"{type(error).__qualname__}: {error}"
            return frame.segments(_ERROR, text, Kind.ERROR)

    def _given(self, ask: Ask, offset: int, limit: float) -> bytes:
        """Return what is handed over; it is made when somebody begins to ask."""
        if ask is Ask.STATE:
            if not offset:
                self._state_frame = _encoded(self._state())
            return self._state_frame
        with first():
            is_decided = self._decided.wait(limit)
        if not is_decided:
            raise Timeout(f"component '{self._runner.spec.name}' is not ready to give")
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
        self._has_given_state = True
        return StateTransfer(state=_frame_of(state))

    def _all(self) -> StateTransfer:
        runner = self._runner
        state = delta = b""
        with runner.at_rest():
            if self._has_given_state:
                delta = _frame_of(runner.component.snapshot_delta())
            else:
                state = _frame_of(runner.component.snapshot())
            waiting = tuple(_waiting(runner))
        now = runner.clock.now()
        return StateTransfer(
            state=state,
            delta=delta,
            waiting=waiting,
            due={name: s.due - now for name, s in runner.schedules.items()},
        )


def _encoded(given: StateTransfer) -> bytes:
    return b"".join(frame.segments(_HANDOVER, given, Kind.RESULT))


def fetch(channel: Channel, ask: Ask, limit: float) -> StateTransfer:
    """Ask the old incarnation.

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
        asked = frame.segments(_ASK, (ask, len(data), left), Kind.CALL)
        answer = channel.request(asked, left)
        if answer.kind is Kind.ERROR:
            text = answer.value(_ERROR)
            raise UsageError(f"the state could not be taken: {text}")
        piece = answer.value(_PIECE)
        data += piece.data
        size = piece.size
    given: StateTransfer = frame.parse(data).value(_HANDOVER)
    return given


def offers_delta(component: Component) -> bool:
    """Whether the state can be sent while the component still works."""
    return type(component).snapshot_delta is not Component.snapshot_delta


def take(
    runner: Runner, given: StateTransfer, adapt: Callable[[Any], Any] | None = None
) -> None:
    """Let a new, inactive incarnation go on from what the old one gave just now.

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
    runner.keep_phases({name: now + left for name, left in given.due.items()})
    with runner.at_rest():
        if given.state:
            if adapt is None:
                _check_restores(component)
            state = _value_of(given.state, adapt or component.restore)
            component.restore(adapt(state) if adapt else state)
        if given.delta:
            component.restore_delta(_value_of(given.delta, component.restore_delta))
    for port, data in given.waiting:
        received = frame.parse(data)
        value = received.value(entry_codec(runner.ports[port], received.tag))
        runner.endpoints.preload(port, (received.tag, value))


def warm_up(runner: Runner) -> None:
    """Look up types and codecs now, which `take` would else do while others wait."""
    for method in (runner.component.restore, runner.component.restore_delta):
        codec(_type_taken_by(method))


def _waiting(runner: Runner) -> list[tuple[str, bytes]]:
    frames = []
    for name, inbox in runner.endpoints.inboxes.items():
        for tag, value in inbox.waiting():
            coder = entry_codec(runner.ports[name], tag)
            pieces = frame.segments(coder, value, Kind.MESSAGE, tag=tag)
            frames.append((name, b"".join(pieces)))
    return frames


def _frame_of(state: Struct | None) -> bytes:
    if state is None:
        return b""
    return b"".join(frame.segments(codec(type(state)), state, Kind.MESSAGE))


def _value_of(data: bytes, method: Any) -> Any:  # noqa: ANN401, a user's method
    return frame.parse(data).value(codec(_type_taken_by(method)))


def check_state(component: type[Component]) -> None:
    """Raise UsageError when what `restore` takes has no type."""
    for name in ("restore", "restore_delta"):
        method = getattr(component, name)
        if method is not getattr(Component, name):
            _type_taken_by(method.__get__(component))


def _check_restores(component: Component) -> None:
    """Raise UsageError when what the component gave would be lost."""
    code = type(component)
    is_given = code.snapshot is not Component.snapshot
    if is_given and code.restore is Component.restore:
        raise UsageError(
            f"{code.__qualname__} has `snapshot`, but no `restore`: its state would be "
            "lost. Write `restore`, or leave `snapshot` out to begin anew"
        )


def _type_taken_by(method: Any) -> Any:  # noqa: ANN401, a user's method
    hints = get_type_hints(method)
    name = next(iter(inspect.signature(method).parameters))
    if name not in hints:
        raise UsageError(
            f"{method.__qualname__}: parameter '{name}' must say the state's type"
        )
    return hints[name]
