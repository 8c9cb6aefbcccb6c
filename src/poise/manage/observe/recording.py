"""A recording of samples in memory, in order: to measure by, or to replay."""

from __future__ import annotations

import threading
import zlib
from pathlib import Path

import msgspec

from poise.errors import RunError, UsageError
from poise.model.policy.seen import Seen
from poise.wire.records.recorded import Recorded
from poise.wire.records.samples import AgentSample

MOST = 200_000
"""The most samples in a recording: eleven hours of one computer at 5 Hz."""
MOST_SEEN = 256 * 2**20
"""The most that is kept of what policies saw [bytes]."""


class Recording:
    """Samples as they came. Its methods may be called from any thread."""

    def __init__(self) -> None:
        self._samples: list[AgentSample] = []
        self._seen: list[bytes] = []
        self._seen_size = 0
        self._lock = threading.Lock()

    def add(self, sample: AgentSample) -> None:
        """Keep a sample, unless there are `MOST` already."""
        with self._lock:
            if len(self._samples) < MOST:
                self._samples.append(sample)

    def take(self) -> list[AgentSample]:
        """Return what was kept since the last time, oldest first, and forget it."""
        with self._lock:
            taken, self._samples = self._samples, []
        return taken

    def add_seen(self, seen: Seen) -> None:
        """Keep what policies saw, unless there are `MOST_SEEN` bytes already."""
        packed = zlib.compress(msgspec.msgpack.encode(seen), level=1)
        with self._lock:
            if self._seen_size + len(packed) <= MOST_SEEN:
                self._seen.append(packed)
                self._seen_size += len(packed)

    def take_seen(self) -> list[bytes]:
        """Return what policies saw, oldest first, and forget it."""
        with self._lock:
            taken, self._seen, self._seen_size = self._seen, [], 0
        return taken


def unpacked(packed: bytes) -> Seen:
    """Return what policies saw at one moment.

    Raises
    ------
    UsageError
        It is something else.
    """
    try:
        return msgspec.msgpack.decode(zlib.decompress(packed), type=Seen)
    except (zlib.error, msgspec.DecodeError) as error:
        raise UsageError(f"the recording is damaged: {error}") from error


def save(recorded: Recorded, path: Path) -> None:
    """Write a recording to a file that `load` reads.

    Raises
    ------
    RunError
        It cannot be written, for instance because the disk is full.
    """
    try:
        path.write_bytes(msgspec.msgpack.encode(recorded))
    except OSError as error:
        raise RunError(
            f"the recording {path} cannot be written: {error.strerror}"
        ) from error


def load(path: Path) -> Recorded:
    """Return the recording in a file.

    Raises
    ------
    UsageError
        It cannot be read, or is no recording.
    """
    try:
        return msgspec.msgpack.decode(path.read_bytes(), type=Recorded)
    except OSError as error:
        raise UsageError(f"recording {path} cannot be read: {error}") from error
    except msgspec.DecodeError as error:
        raise UsageError(f"{path} is no recording: {error}") from error
