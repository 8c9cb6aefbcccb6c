"""The source's side of a state transfer.

The target requests the state, as a call: first while the source works (`Request.STATE`,
for components that offer `snapshot_delta`), then everything (`Request.ALL`), which is
answered once the source is paused and drained.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from enum import IntEnum

import msgspec
from msgspec import Struct

from poise.clock import Stamp
from poise.errors import RunError, Timeout
from poise.priority import ahead, first
from poise.runtime.connectors.channel_route import entry_codec
from poise.runtime.execution.container_lease import check_lease
from poise.runtime.execution.data_age import Stamped
from poise.runtime.execution.exclusion import new_chain
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration.state_check import describe_type
from poise.wire import frame
from poise.wire.codec import Codec, codec
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.frame import Frame, Kind, Pieces

SERVE_LIMIT = 1.0
"""A snapshot waits at most this long for the component's turn [s]."""


class Request(IntEnum):
    """What a target requests."""

    STATE = 1
    ALL = 2


class StateTransfer(Struct, frozen=True, kw_only=True):
    """All that lets the target go on where the source stopped."""

    # Frames with what `snapshot` or `snapshot_delta` gave; empty: nothing
    state: bytes = b""
    state_type: str = ""  # The type of the state, by `state_check.describe_type`
    # Frames with what `snapshot` or `snapshot_delta` gave; empty: nothing
    delta: bytes = b""
    # Ports, frames and stamps of the messages and one-way calls that wait, oldest first
    messages: tuple[tuple[str, bytes, Mapping[str, Stamp]], ...] = ()
    due: Mapping[str, float] = {}  # Timer -> time until its next release [s]
    # Chain -> the stamp of the data that the source took last
    stamps: Mapping[str, Stamp] = {}


REQUEST: Codec[tuple[int, float]] = codec(tuple[int, float])
"""What is requested, and how long the target waits [s]."""
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
        self._decided = threading.Event()
        self._why_not = ""
        self._serving = threading.Lock()
        self._taken: StateTransfer | None = None
        server.open(self._key, self._serve)

    def send(self) -> None:
        """Answer from now on: the component is paused, and its channels are drained."""
        self._why_not = ""
        self._decided.set()

    def refuse(self, reason: str) -> None:
        """Answer with the reason why no state is sent."""
        self._why_not = reason
        self._decided.set()

    def close(self) -> None:
        """Serve no more."""
        self.refuse("the offer is withdrawn")
        self._server.shut(self._key)

    def _serve(self, received: Frame) -> Pieces:
        """Answer a target; a component's error crosses as text."""
        try:
            request, limit = received.value(REQUEST)
            with self._serving:
                if request == Request.STATE:
                    transfer = self._state()
                else:
                    self._wait_decided(limit)
                    # a request whose answer got lost gets the same delta again
                    transfer = self._taken = self._taken or self._all()
                # a snapshot may take long
                check_lease(self._runner.lease, self._runner.spec.name)
                return frame.segments(TRANSFER, transfer, Kind.RESULT)
        except Exception as error:  # noqa: BLE001, a user's snapshot may raise anything
            return frame.failure(type(error).__qualname__, str(error))

    def _state(self) -> StateTransfer:
        self._runner.exclusion.enter(new_chain(), SERVE_LIMIT)
        try:
            state = self._runner.component.snapshot()
        finally:
            self._runner.exclusion.leave()
        self._has_sent_state = True
        return _transfer(state)

    def _wait_decided(self, limit: float) -> None:
        with first():
            is_decided = self._decided.wait(limit)
        if not is_decided:
            name = self._runner.spec.name
            raise Timeout(f"component '{name}' is not ready to send")
        if self._why_not:
            raise RunError(self._why_not)

    def _all(self) -> StateTransfer:
        runner = self._runner
        with ahead(), runner.gate.borrowed():  # users' code
            if self._has_sent_state:
                delta = _frame_of(runner.component.snapshot_delta())
                transfer = StateTransfer(delta=delta)
            else:
                transfer = _transfer(runner.component.snapshot())
            messages = tuple(_messages(runner))
        due = runner.timers.left(runner.clock.now())
        return msgspec.structs.replace(
            transfer, messages=messages, due=due, stamps=runner.ages.held()
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
        pieces = frame.segments(coder, value, Kind.MESSAGE, tag=tag)
        yield name, b"".join(pieces), stamps


def _frame_of(state: Struct | None) -> bytes:
    if state is None:
        return b""
    return b"".join(frame.segments(codec(type(state)), state, Kind.MESSAGE))
