"""Frames over stream sockets; the headers in ``wire/native`` explain them."""

from mmap import mmap
from typing import Any

from poise.wire.codec import Bytes, Codec
from poise.wire.frame import Frame

class Channel:
    """Frames over a connected stream socket, each behind its head.

    It waits without Python's lock. One thread at a time may use it in each direction,
    and none once the socket was closed. `file` is the socket's descriptor; over TCP the
    other end is gone when its computer confirms nothing for `lost_after` [s]. Without
    `reads_ahead`, no byte of the next frame is read, so `poll` reports each frame.
    Deadlines are moments of the monotonic clock [s], and infinity is none; a frame has
    at most `largest` bytes.

    All methods raise
    ----------------
    Timeout
        The deadline came first. Part of the bytes may have crossed.
    Unavailable
        The other end is gone.
    WireError
        The frame is too large, or it is none.
    """

    def __init__(
        self, file: int, lost_after: float, reads_ahead: bool = True
    ) -> None: ...
    def is_lost(self) -> bool: ...
    def send(
        self,
        pieces: list[Bytes],
        deadline: float,
        largest: int,
        block: int = 0,
        used: int = 0,
        target: memoryview | None = None,
        file: int = -1,
    ) -> None: ...
    def receive(
        self, deadline: float, largest: int, lenders: dict[int, Lender]
    ) -> Frame | tuple[int, int, bytes]: ...
    def ask(
        self,
        pieces: list[Bytes],
        deadline: float,
        largest: int,
        lenders: dict[int, Lender],
        block: int = 0,
        used: int = 0,
        target: memoryview | None = None,
        file: int = -1,
    ) -> Frame | tuple[int, int, bytes] | None: ...
    def take_file(self) -> int: ...

class Lender:
    """The receiver's side of a block: its data, and its byte `slot` of the flags.

    That byte is cleared when the last view of what was lent is gone.
    """

    def __init__(self, data: mmap, flags: mmap, slot: int) -> None: ...
    def lend(self, used: int) -> memoryview: ...

def parse(data: Bytes, buffers: memoryview | None = None) -> Frame: ...
def segments(
    codec: Codec[Any],
    value: object,
    kind: int,
    tag: int = 0,
    number: int = 0,
    chain: int = 0,
) -> list[Bytes]: ...
def address(memory: Bytes) -> int: ...

class Lent:
    """Bytes of shared memory that a message holds; given back when nobody does."""
