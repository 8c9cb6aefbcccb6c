"""Bytes between containers of one computer; the code is in ``wire/native``."""

from poise.wire.codec import Bytes

class Channel:
    """Pieces of bytes over a connected stream socket, each behind a head.

    It waits without Python's lock. One thread at a time may use it in each direction,
    and none once the socket was closed. `file` is the socket's descriptor; deadlines
    are moments of the monotonic clock [s], and infinity is none.

    All methods raise
    ----------------
    Timeout
        The deadline came first. Part of the bytes may have crossed.
    Unavailable
        The other end is gone.
    """

    def __init__(self, file: int) -> None: ...
    def send(
        self, pieces: list[Bytes], deadline: float, block: int = 0, used: int = 0
    ) -> None:
        """Send a head and all of `pieces`; `used` crosses when `block` is not 0."""

    def receive(
        self, deadline: float, largest: int
    ) -> tuple[int, int, int, bytes | None]:
        """Return length, `block` and `used` of the next head, and the bytes behind it.

        None instead of more than `largest` bytes.
        """

    def take(self, size: int, deadline: float) -> bytes:
        """Return the next `size` bytes, without a head."""

def fill(target: object, start: int, pieces: list[Bytes]) -> None:
    """Copy pieces into writable memory from `start` on, without Python's lock.

    Raises
    ------
    ValueError
        There is not room enough.
    """
