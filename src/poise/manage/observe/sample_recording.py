"""Samples as they come: kept until they are taken, or written to a file at once."""

from __future__ import annotations

import threading
import zlib
from collections import deque
from pathlib import Path

import msgspec

from poise.errors import UsageError
from poise.manage.background_file import BackgroundFile
from poise.model.policy.policy import Seen
from poise.units import counted
from poise.wire.recording_file import Recorded, append, packed
from poise.wire.records.sample_records import AgentSample

MOST = 10_000
"""The most samples that wait to be taken: 33 minutes of one computer at 5 Hz."""
MOST_WAITING = 32 << 20
"""The most that waits for the disk [bytes]."""


class Recording:
    """Samples in memory. Its methods may be called from any thread.

    Of more than `MOST` the latest are kept.
    """

    def __init__(self) -> None:
        self._samples: deque[AgentSample] = deque(maxlen=MOST)
        self._lock = threading.Lock()
        self._missing = 0

    def add(self, sample: AgentSample) -> None:
        """Keep a sample."""
        with self._lock:
            self._missing += len(self._samples) == MOST
            self._samples.append(sample)

    @property
    def trouble(self) -> str:
        """How many there was no room for, in words; empty: for all."""
        missing = self._missing
        what = "came while the manager was busy, and are lost"
        return f"{counted(missing, 'sample')} of agents {what}" if missing else ""

    def take(self) -> list[AgentSample]:
        """Return what was kept since the last time, oldest first, and forget it."""
        with self._lock:
            taken = list(self._samples)
            self._samples.clear()
        return taken


class RecordingFile:
    """Writes a recording while it is made. Its methods may be called from any thread.

    They neither raise nor wait for the disk: what it does not take is dropped and
    counted, `file.trouble` says so, and the robot goes on.
    """

    def __init__(self, path: Path, robot: str) -> None:
        if path.is_file():
            path.unlink()
        append(Recorded(robot=robot), path)
        self.count = 0
        self._robot = robot
        self.file = BackgroundFile(path, "the recording", "record", most=MOST_WAITING)
        self.file.start()

    def add(self, sample: AgentSample) -> None:
        """Write a sample."""
        self.count += 1
        self._add(Recorded(robot=self._robot, samples=[sample]))

    def add_seen(self, seen: Seen) -> None:
        """Write what policies saw."""
        compressed = zlib.compress(msgspec.msgpack.encode(seen), level=1)
        self._add(Recorded(robot=self._robot, seen=[compressed]))

    def close(self) -> None:
        """Write what still waits, within 2 s."""
        self.file.close()

    def __str__(self) -> str:
        """Return how much there is, and is not, for people."""
        trouble = self.file.trouble
        said = f"recorded {self.count} samples to {self.file.path}"
        return f"{said}; {trouble}" if trouble else said

    def _add(self, part: Recorded) -> None:
        self.file.add(packed(part))


def unpacked(compressed: bytes) -> Seen:
    """Return what policies saw at one moment."""
    try:
        return msgspec.msgpack.decode(zlib.decompress(compressed), type=Seen)
    except (zlib.error, msgspec.DecodeError) as error:
        raise UsageError(f"the recording is damaged: {error}") from error
