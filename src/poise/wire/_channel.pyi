"""Frames over stream sockets; the headers in ``wire/native`` explain them."""

from mmap import mmap
from typing import Any

from poise.wire.codec import Bytes, Codec
from poise.wire.frame import Frame

class Channel:
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
    ) -> Frame | tuple[int, int, bytes] | None: ...
    def take(self, size: int, deadline: float) -> bytes: ...

class Lender:
    def __init__(self, data: mmap, flags: mmap, slot: int) -> None: ...

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

class Lent: ...
