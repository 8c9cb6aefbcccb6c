import mmap
from typing import Any

import poise.wire.codec
import poise.wire.frame

class Channel:
    """Frames over a connected stream socket (channel.h)."""

    def __init__(
        self, file: int, lost_after: float, reads_ahead: bool = True
    ) -> None: ...
    def is_lost(self) -> bool: ...
    def wait(self, event: int, deadline: float) -> None: ...
    def send(
        self,
        pieces: list[poise.wire.codec.Bytes],
        deadline: float,
        largest: int,
        block: int = 0,
        used: int = 0,
        target: memoryview | None = None,
        file: int = -1,
    ) -> None: ...
    def receive(
        self, deadline: float, largest: int, lenders: dict[int, Lender]
    ) -> poise.wire.frame.Frame | tuple[int, int, bytes]: ...
    def ask(
        self,
        pieces: list[poise.wire.codec.Bytes],
        deadline: float,
        largest: int,
        lenders: dict[int, Lender],
        block: int = 0,
        used: int = 0,
        target: memoryview | None = None,
        file: int = -1,
    ) -> poise.wire.frame.Frame | tuple[int, int, bytes] | None: ...
    def take_file(self) -> int: ...
    def lend(self, lender: Lender, used: int, deadline: float) -> memoryview: ...

class Lender:
    """The receiver's side of a block (lender.h)."""

    def __init__(self, data: mmap.mmap, flags: mmap.mmap, slot: int) -> None: ...

class Lent:
    """What was sent on a block, until nobody looks at it."""

def parse(
    data: poise.wire.codec.Bytes, buffers: memoryview | None = None
) -> poise.wire.frame.Frame: ...
def segments(
    codec: poise.wire.codec.Codec[Any],
    value: object,
    kind: int,
    tag: int = 0,
    number: int = 0,
    chain: int = 0,
) -> list[poise.wire.codec.Bytes]: ...
def address(memory: poise.wire.codec.Bytes) -> int: ...
