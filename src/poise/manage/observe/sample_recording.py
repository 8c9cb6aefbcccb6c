"""Samples as they come: kept until they are taken, or written to a file at once."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from poise.clock import steady_wall_time
from poise.manage.background_file import BackgroundWriter
from poise.model.policy import Seen
from poise.units import counted
from poise.wire.recording_file import SEEN, McapFile, message_of
from poise.wire.records.status_records import AgentSample

MOST = 10_000
"""The most samples that wait to be taken: 33 minutes of one computer at 5 Hz."""
MOST_WAITING = 32 << 20
"""The most that waits for the disk [bytes]."""
_WRITE_EVERY = 1.0
"""What came meanwhile is compressed and written at once [s]."""


class Recording:
    """The latest samples, in memory, for any thread."""

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
        what = "arrived while the manager was busy, and were dropped"
        return f"{counted(missing, 'sample')} of agents {what}" if missing else ""

    def drain(self) -> list[AgentSample]:
        """Return what was kept since the last time, oldest first, and forget it."""
        with self._lock:
            taken = list(self._samples)
            self._samples.clear()
        return taken


class RecordingFile(BackgroundWriter[tuple[str, float, bytes]]):
    """Writes a recording while it is made: records with their topics and moments.

    What the disk does not take is dropped and counted, and the robot goes on. A kill
    loses what came within the last second.
    """

    close_limit = 30.0

    def __init__(self, path: Path, robot: str) -> None:
        self.file = McapFile(path, robot, replaces=True)
        self.count = 0
        """How many samples are written."""
        self._time = steady_wall_time()
        super().__init__(
            path, "the recording", "record", most=MOST_WAITING, every=_WRITE_EVERY
        )
        self.start()

    def add(self, record: AgentSample | Seen) -> None:
        """Write a sample, or what policies saw, soon."""
        topic, data = message_of(record)
        self.put((topic, self._time(), data), len(data))

    def write(self, records: Sequence[tuple[str, float, bytes]]) -> None:
        """Compress records, and write them."""
        for topic, at, data in records:
            self.file.add(topic, None, at, data)
            self.note_written(1)
            self.count += topic != SEEN
        self.file.flush()

    def end(self) -> None:
        """End the file: it is whole then."""
        self.file.close()

    def __str__(self) -> str:
        """Return how much there is, and is not, for people."""
        said = f"recorded {self.count} samples to {self.path}"
        return f"{said}; {self.trouble}" if self.trouble else said
