"""Counts what a container uses, and leaves the numbers where its agent finds them.

A page of shared memory instead of a message: neither the container nor the agent wakes
the other, so a hundred components cost the agent one wake-up for all.
"""

from __future__ import annotations

import contextlib
import logging
import mmap
import os
import struct
import threading
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import msgspec

from poise.wire.samples import ContainerSample

log = logging.getLogger(__name__)

SIZE = 1 << 20
"""A sample is smaller [bytes]; pages that are never touched take no memory."""
MEMORY_EVERY = 50
"""Memory is read with every so many-th sample: it costs as much as all the rest."""
_HEAD = struct.Struct("<II")
Read = Callable[[int], ContainerSample]


class Sampler:
    """A thread that calls `read` every so often and leaves what it returns in a file.

    Parameters
    ----------
    path
        The file, from `sample_path`.
    every
        [s]; > 0.
    read
        Called on the thread with the last known memory [bytes]; must not block.
    weigh
        Returns the memory [bytes]; called on the thread, seldom.
    """

    def __init__(
        self, path: Path, every: float, read: Read, weigh: Callable[[], int]
    ) -> None:
        self._path = path
        self._every = every
        self._read = read
        self._weigh = weigh
        self._is_ended = False
        self._encoder = msgspec.msgpack.Encoder()
        self._thread = threading.Thread(target=self._main, name="sampler", daemon=True)

    def start(self) -> None:
        """Make the file, and begin to sample."""
        fd = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
        os.ftruncate(fd, SIZE)
        self._page = mmap.mmap(fd, SIZE)
        os.close(fd)
        self._thread.start()

    def stop(self) -> None:
        """Let the thread end at its next wake-up, and remove the file."""
        self._is_ended = True
        self._path.unlink(missing_ok=True)

    def _main(self) -> None:
        memory = 0
        count = 0
        with self._page as page:
            # A plain sleep costs half of a wait that could be ended early.
            while not self._is_ended:
                time.sleep(self._every)
                if count % MEMORY_EVERY == 0:
                    memory = self._weigh()
                count += 1
                self._leave(page, self._encoder.encode(self._read(memory)))

    def _leave(self, page: mmap.mmap, body: bytes) -> None:
        if len(body) > SIZE - _HEAD.size:
            log.warning("a sample of %d bytes is too large to be told", len(body))
            return
        # A reader that comes in between sees a checksum that does not fit.
        page[: _HEAD.size] = _HEAD.pack(len(body), 0)
        page[_HEAD.size : _HEAD.size + len(body)] = body
        page[: _HEAD.size] = _HEAD.pack(len(body), zlib.crc32(body))


class Page:
    """The agent's view of a container's file, which may not be there yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._page: mmap.mmap | None = None
        self._seen = 0

    def read(self) -> bytes | None:
        """Return the sample there, encoded; None when there is none or no new one."""
        if self._page is None and not self._open():
            return None
        assert self._page is not None  # noqa: S101, it was just opened
        length, checksum = _HEAD.unpack(self._page[: _HEAD.size])
        if checksum == self._seen or length > SIZE - _HEAD.size:
            return None
        body = self._page[_HEAD.size : _HEAD.size + length]
        if zlib.crc32(body) != checksum:
            return None
        self._seen = checksum
        return body

    def close(self) -> None:
        """Let the file go."""
        if self._page is not None:
            self._page.close()

    def _open(self) -> bool:
        with contextlib.suppress(OSError, ValueError):  # not made, or not yet sized
            fd = os.open(self._path, os.O_RDONLY)
            try:
                self._page = mmap.mmap(fd, SIZE, prot=mmap.PROT_READ)
            finally:
                os.close(fd)
        return self._page is not None


class ThreadWait:
    """How long a thread could run and did not, from the kernel's own counters.

    Zero for ever where the kernel does not count that.
    """

    def __init__(self) -> None:
        self._fd = -1
        self._tried = False

    def read(self, thread: int) -> float:
        """Return the time [s]; `thread` is its number as the kernel counts.

        The first number counts: the file stays open.
        """
        if not self._tried:
            self._tried = True
            with contextlib.suppress(OSError):
                self._fd = os.open(f"/proc/{thread}/schedstat", os.O_RDONLY)
        if self._fd < 0:
            return 0.0
        try:
            return int(os.pread(self._fd, 64, 0).split()[1]) * 1e-9
        except (OSError, IndexError):  # the thread has ended
            return 0.0

    def close(self) -> None:
        """Let the counter go."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def sample_path(folder: Path, container: str, pid: int) -> Path:
    """Return where a container leaves its samples; a restarted one, elsewhere."""
    return folder / f"{container}.{pid}.samples"


def proportional_memory(process: int | str = "self") -> int:
    """Return a process's proportional set size [bytes]; 0 when nobody tells."""
    try:
        text = Path(f"/proc/{process}/smaps_rollup").read_bytes()
    except OSError:
        return 0
    for line in text.splitlines():
        if line.startswith(b"Pss:"):
            return int(line.split()[1]) * 1024
    return 0
