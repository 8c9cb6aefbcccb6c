"""The last message of a port that is ``published(latest=True)``, for late subscribers.

Such messages are numbered. A target says with its credit which one it got last; when
the source has a later one, and nothing is on its way, it sends that *again*. A target
takes none twice, and none again that is older than what it has. A move takes along the
source's last message, and the numbers of the target.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec

from poise.clock import wall_time
from poise.decoding import msgpack_decoder
from poise.runtime.connectors.interface import message_tag
from poise.runtime.execution.data_age import Stamped
from poise.wire import frame
from poise.wire.codec import Codec, codec
from poise.wire.frame import FrameKind

Number = tuple[int, int]
"""The epoch of the publisher, and the time [ns since 1970], later than all before."""
NONE: Number = (0, 0)
HEARD: Codec[Number | None] = codec(Number | None)
"""Which message came last over a connector; None: none did, or its target is older."""


class Numbered(NamedTuple):
    """A message with its number, and whether it is sent again."""

    number: Number
    is_again: bool
    value: Any


def numbered(coder: Codec[Any]) -> Codec[tuple[Number, bool, Any]]:
    """Return the codec of numbered messages."""
    return codec(tuple[Number, bool, coder.type], coder.name)  # type: ignore[name-defined]


def numbered_tag(type_: type) -> int:
    """Return the tag of numbered messages of a type."""
    return message_tag(type_) ^ 1


_with_raw = msgpack_decoder(tuple[Number, bool, msgspec.Raw]).decode


def without_number(body: bytes) -> bytes:
    """Return the body of a message from that of a numbered one."""
    return bytes(_with_raw(body)[2])


class LatestMessage:
    """The last message that a component published to one port, from any thread."""

    def __init__(self, type_: type, epoch: int) -> None:
        self.last: Numbered | None = None
        self._type = type_
        self._epoch = epoch
        self._lock = threading.Lock()

    def next(self, message: object) -> Numbered:
        """Return a message that is published now, with its number."""
        with self._lock:
            epoch, at = self.last.number if self.last else NONE
            number = max((self._epoch, round(1e9 * wall_time())), (epoch, at + 1))
            self.last = Numbered(number, False, message)
            return self.last

    def numbering(self, send: Callable[[object], None]) -> Callable[[object], None]:
        """Return a function that keeps a message, and sends it with its number."""

        def send_numbered(message: object) -> None:
            send(self.next(message))

        return send_numbered

    def to_frame(self) -> bytes:
        """Return the last message as a frame; empty: there is none."""
        if self.last is None:
            return b""
        coder, tag = numbered(codec(self._type)), numbered_tag(self._type)
        return b"".join(frame.segments(coder, self.last, FrameKind.MESSAGE, tag=tag))

    def restore(self, data: bytes) -> None:
        """Go on with the last message of the incarnation before, if its type fits."""
        received = frame.parse(data)
        if received.tag == numbered_tag(self._type):
            self.last = Numbered(*received.value(numbered(codec(self._type))))


class LatestMessages(dict[str, LatestMessage]):
    """Those of one component, by port."""

    def to_frames(self) -> dict[str, bytes]:
        """Return the last messages, where there are any."""
        frames = {port: latest.to_frame() for port, latest in self.items()}
        return {port: data for port, data in frames.items() if data}

    def restore(self, frames: Mapping[str, bytes]) -> None:
        """Go on with those of the incarnation before."""
        for port in self.keys() & frames:
            self[port].restore(frames[port])


Heard = dict[str, Number]
"""Connector -> the number of the last message that came over it to one port."""


def take(
    heard: Heard,
    connector: str,
    value: Any,  # noqa: ANN401, as it came
    put: Callable[[Any], object],
) -> None:
    """Hand a numbered message on, unless it has come before."""
    stamped = value if type(value) is Stamped else None
    number, is_again, message = value.value if stamped else value
    before = heard.get(connector, NONE)
    if number == before or (is_again and number < before):
        return
    heard[connector] = max(number, before)
    put(stamped._replace(value=message) if stamped else message)
