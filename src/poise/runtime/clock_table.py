"""What is known of other computers' clocks, where all containers of one can read it.

A page of shared memory: the agent writes, containers look when they want to know how
old something is, and neither wakes the other.
"""

from __future__ import annotations

import contextlib
import logging
import mmap
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import msgspec

from poise.clock import DRIFT, Elapsed, Stamp, SystemClock
from poise.wire.records.clocks import ClockStatus

log = logging.getLogger(__name__)

SIZE = 1 << 16
"""Room for several hundred computers [bytes]."""
_HEAD = struct.Struct("<II")


class ClockTable:
    """The agent's end; the file is made anew.

    Parameters
    ----------
    folder
        The agent's.
    """

    def __init__(self, folder: Path) -> None:
        path = clocks_path(folder)
        path.unlink(missing_ok=True)
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            os.ftruncate(fd, SIZE)
            self._page = mmap.mmap(fd, SIZE)
        finally:
            os.close(fd)
        self._encoder = msgspec.msgpack.Encoder()

    def write(self, clocks: Mapping[str, ClockStatus]) -> None:
        """Leave what is known now; of more than there is room for, the first ones."""
        body = self._encoder.encode(clocks)
        while len(body) > SIZE - _HEAD.size:
            log.warning("there is no room for the clocks of %d computers", len(clocks))
            clocks = dict(list(clocks.items())[: len(clocks) // 2])
            body = self._encoder.encode(clocks)
        # a reader that looks in between sees that sum and body do not fit
        self._page[_HEAD.size : _HEAD.size + len(body)] = body
        self._page[: _HEAD.size] = _HEAD.pack(len(body), zlib.crc32(body))

    def close(self) -> None:
        """Let the page go."""
        self._page.close()


class ComputerClock(SystemClock):
    """The clock of a container's components.

    Parameters
    ----------
    computer
        The name of its computer.
    folder
        The folder of its agent, who knows of other computers' clocks.
    """

    def __init__(self, computer: str, folder: Path) -> None:
        super().__init__(computer)
        self._path = clocks_path(folder)
        self._page: mmap.mmap | None = None
        self._seen = b""
        self._clocks: dict[str, ClockStatus] = {}
        self._decoder = msgspec.msgpack.Decoder(dict[str, ClockStatus])

    def since(self, stamp: Stamp) -> Elapsed | None:
        """Return how long ago a stamp was, with what is known of its clock."""
        if stamp.computer == self._computer:
            return super().since(stamp)
        ahead = self.ahead(stamp.computer)
        if ahead is None:
            return None
        return Elapsed(self.now() + ahead.value - stamp.at, ahead.error)

    def ahead(self, computer: str) -> Elapsed | None:
        """Return how far another computer's clock is ahead [s]; None: nobody knows."""
        known = self._known().get(computer)
        if known is None:
            return None
        error = known.error + DRIFT * max(0.0, self.now() - known.at)
        return Elapsed(known.offset, error)

    def _known(self) -> Mapping[str, ClockStatus]:
        if self._page is None and not self._open():
            return {}
        assert self._page is not None  # noqa: S101, it is open now
        head = self._page[: _HEAD.size]
        if head != self._seen:
            length, checksum = _HEAD.unpack(head)
            body = self._page[_HEAD.size : _HEAD.size + length]
            if zlib.crc32(body) == checksum and length:
                self._clocks, self._seen = self._decoder.decode(body), head
        return self._clocks

    def _open(self) -> bool:
        with contextlib.suppress(OSError, ValueError):  # not made, or not yet sized
            fd = os.open(self._path, os.O_RDONLY)
            try:
                self._page = mmap.mmap(fd, SIZE, prot=mmap.PROT_READ)
            finally:
                os.close(fd)
        return self._page is not None


def clocks_path(folder: Path) -> Path:
    """Return where an agent leaves what it knows of other clocks."""
    return folder / "clocks"
