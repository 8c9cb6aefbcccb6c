"""Frames between containers of one computer; the code is in ``wire/native``."""

from typing import Any

from poise.wire.codec import Bytes, Codec
from poise.wire.frame import Frame

class Channel:
    """Frames over a connected stream socket, each behind the head of a link.

    It waits without Python's lock. One thread at a time may use it in each direction,
    and none once the socket was closed. `file` is the socket's descriptor; deadlines
    are moments of the monotonic clock [s], and infinity is none; a frame has at most
    `largest` bytes.

    All methods raise
    ----------------
    Timeout
        The deadline came first. Part of the bytes may have crossed.
    Unavailable
        The other end is gone.
    WireError
        The frame is too large, or it is none.
    """

    def __init__(self, file: int) -> None: ...
    def send(
        self,
        pieces: list[Bytes],
        deadline: float,
        largest: int,
        block: int = 0,
        used: int = 0,
    ) -> None:
        """Send a head and all of `pieces`; `used` crosses when `block` is not 0."""

    def receive(self, deadline: float, largest: int) -> Frame | tuple[int, int, bytes]:
        """Return the next frame.

        Behind a head with a block: `block`, `used` and the frame's bytes.
        """

    def ask(
        self, pieces: list[Bytes], deadline: float, largest: int
    ) -> Frame | tuple[int, int, bytes] | None:
        """Send and receive; None when the other end was gone before it had all."""

    def take(self, size: int, deadline: float) -> bytes:
        """Return the next `size` bytes, without a head."""

def parse(data: Bytes, buffers: memoryview | None = None) -> Frame:
    """Return the frame in `data`: see `poise.wire.frame.parse`."""

def segments(
    codec: Codec[Any],
    value: object,
    kind: int,
    tag: int = 0,
    number: int = 0,
    chain: int = 0,
) -> list[Bytes]:
    """Return the pieces of a frame: see `poise.wire.frame.segments`."""

def fill(target: object, start: int, pieces: list[Bytes]) -> None:
    """Copy pieces into writable memory from `start` on, without Python's lock.

    Raises
    ------
    ValueError
        There is not room enough.
    """
