"""Samples as they come: kept until they are taken, or written to a file at once."""

from __future__ import annotations

import threading
import time
from collections import deque
from pathlib import Path

from poise import threads
from poise.clock import wall_time
from poise.errors import RunError
from poise.model.policy.policy import Seen
from poise.units import counted
from poise.wire.recording_file import McapFile, message_of
from poise.wire.records.status_records import AgentSample

MOST = 10_000
"""The most samples that wait to be taken: 33 minutes of one computer at 5 Hz."""
MOST_WAITING = 32 << 20
"""The most that waits for the disk [bytes]."""
_WRITE_EVERY = 1.0
"""What came meanwhile is compressed and written at once [s]."""
_SLOW_AFTER, _CLOSE_LIMIT = 2.0, 30.0
"""A disk that has not answered for so long is said to be the trouble; a recording is
ended within so much [s]."""


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
        what = "arrived while the manager was busy, and were dropped"
        return f"{counted(missing, 'sample')} of agents {what}" if missing else ""

    def drain(self) -> list[AgentSample]:
        """Return what was kept since the last time, oldest first, and forget it."""
        with self._lock:
            taken = list(self._samples)
            self._samples.clear()
        return taken


class RecordingFile:
    """Writes a recording while it is made; its methods neither raise nor wait for it.

    What the disk does not take is dropped and counted, and the robot goes on. A kill
    loses what came within the last second.
    """

    def __init__(self, path: Path, robot: str) -> None:
        self.file = McapFile(path, robot, replaces=True)
        self.count = 0
        """How many samples came."""
        self.missing = 0
        """How many records were dropped."""
        self._waiting: list[tuple[str, float, bytes]] = []
        self._size = 0
        self._changed = threading.Condition()
        self._is_closing = False
        self._error = ""
        self._began: float | None = None
        self._thread = threads.daemon(self._main, "recording", again=True)
        self._thread.start()

    def add(self, sample: AgentSample) -> None:
        """Write a sample soon."""
        self.count += 1
        self._put(*message_of(sample))

    def add_seen(self, seen: Seen) -> None:
        """Write soon what policies saw."""
        self._put(*message_of(seen))

    @property
    def trouble(self) -> str:
        """Why records are not written, and how many lack; empty: all is well."""
        began, error = self._began, self._error
        if not error and began and time.monotonic() - began > _SLOW_AFTER:
            error = f"its disk has not answered for {_SLOW_AFTER:g} s"
        said = [f"cannot be written: {error}"] if error else []
        said += [f"lacks {counted(self.missing, 'record')}"] if self.missing else []
        return f"the recording {self.file.path} {', '.join(said)}" if said else ""

    def close(self) -> None:
        """Write what waits and end the file, within half a minute; add nothing more."""
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        self._thread.join(_CLOSE_LIMIT)

    def __str__(self) -> str:
        """Return how much there is, and is not, for people."""
        said = f"recorded {self.count} samples to {self.file.path}"
        return f"{said}; {self.trouble}" if self.trouble else said

    def _put(self, topic: str, data: bytes) -> None:
        with self._changed:
            if self._is_closing or self._size + len(data) > MOST_WAITING:
                self.missing += 1
                return
            self._waiting.append((topic, wall_time(), data))
            self._size += len(data)

    def _main(self) -> None:
        is_closing = False
        while not is_closing:
            with self._changed:
                is_closing = self._changed.wait_for(
                    lambda: self._is_closing, _WRITE_EVERY
                )
                taken, self._waiting, self._size = self._waiting, [], 0
            self._began = time.monotonic()
            self._write(taken)
            self._began = None
        try:
            self.file.close()
        except RunError as error:
            self._error = str(error)

    def _write(self, taken: list[tuple[str, float, bytes]]) -> None:
        written = 0
        try:
            for topic, at, data in taken:
                self.file.add(topic, None, at, data)
                written += 1
            self.file.flush()
            self._error = ""
        except RunError as error:
            self._error = str(error)
        self.missing += len(taken) - written
