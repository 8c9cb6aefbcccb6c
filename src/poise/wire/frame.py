"""One frame: what crosses a connector between containers.

::

    version u8, kind u8, tag u16, body length u32, number u64, chain u64, sent u64,
    body, padding, buffers

Little endian. `tag` is a checksum of the name and types of a method or message type.
`number` identifies a marker, counts messages and one-way calls, and is the time that
the caller of a call still waits [ns]; 0: no limit. `chain` is the call chain of a call,
or identifies the route of a message (`poise.runtime.connectors.flow_control`). `sent`
is the time on the sender's monotonic clock [ns]. The buffers may lie in shared memory.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from msgspec import Struct

from poise.wire import _channel
from poise.wire.codec import Bytes, Codec

VERSION = 2
LARGEST = 1 << 30
"""No frame on any socket is larger [bytes]; a larger one is refused."""
_HEAD = 32
"""The size of the head [bytes]."""
_INLINE = 2
"""Head and body; padding and buffers follow."""


class Kind(IntEnum):
    """The kinds of frames."""

    MESSAGE = 1
    CALL = 2
    ONEWAY = 3
    RESULT = 4
    ERROR = 5
    HELLO = 6
    MOVED = 7
    MARKER = 8
    CREDIT_REQUEST = 9
    CREDIT = 10
    RECORD = 11


Pieces = list[Bytes]
"""A frame as it is sent, one piece after the other."""

segments = _channel.segments
"""Return the pieces of a frame; the buffers of its value are not copied."""

parse = _channel.parse
"""Return the frame in bytes; its buffers lie behind the body, or are given.

WireError when the bytes are cut short, or from a protocol version that is not ours.
"""

FAILURE: Codec[tuple[str, str, str]] = Codec(tuple[str, str, str])
"""The body of an ERROR: type, message and traceback."""


class Frame(Struct, frozen=True):
    """A received frame; nothing else writes to its body and its buffers."""

    kind: Kind
    tag: int
    number: int
    chain: int
    body: Bytes
    buffers: memoryview
    size: int  # As `size_of` returned it where it was sent [bytes]
    # The time when it was parsed, less the time when it was sent [s], each on its own
    # computer's clock
    age: float
    came: float  # When it was parsed [s, on this computer's monotonic clock]

    def value(self, codec: Codec[Any]) -> Any:  # noqa: ANN401, what the codec decodes
        """Return the decoded value; WireError when it is not of the codec's type."""
        return codec.decode(self.body, self.buffers)


def failure(
    type_name: str, message: str, traceback: str = "", number: int = 0
) -> Pieces:
    """Return the answer to a call that failed; a callee's error has a traceback."""
    said = type_name, message, traceback
    return segments(FAILURE, said, Kind.ERROR, number=number)


def size_of(pieces: Pieces) -> int:
    """Return the size of a frame [bytes], without padding."""
    if len(pieces) == _INLINE:
        return _HEAD + len(pieces[1])
    return sum(map(len, pieces)) - len(pieces[_INLINE])
