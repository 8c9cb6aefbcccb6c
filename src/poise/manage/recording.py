"""What agents told of what they use, kept in order: to measure by, or to replay."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec

from poise.errors import UsageError
from poise.wire.samples import AgentSample

MOST = 200_000
"""A recording holds at most so many samples: eleven hours of one computer at 5 Hz."""


class Recording:
    """Samples as they came. Its methods may be called from any thread."""

    def __init__(self) -> None:
        self._samples: list[AgentSample] = []
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


def save(samples: Iterable[AgentSample], path: Path) -> None:
    """Write samples to a file that `load` reads."""
    path.write_bytes(msgspec.msgpack.encode(list(samples)))


def load(path: Path) -> list[AgentSample]:
    """Return the samples in a file, oldest first.

    Raises
    ------
    UsageError
        It cannot be read, or is no recording.
    """
    try:
        return msgspec.msgpack.decode(path.read_bytes(), type=list[AgentSample])
    except OSError as error:
        raise UsageError(f"recording {path} cannot be read: {error}") from error
    except msgspec.DecodeError as error:
        raise UsageError(f"{path} is no recording: {error}") from error


def replay(
    samples: Iterable[AgentSample], take: Callable[[AgentSample], object]
) -> None:
    """Hand samples to an estimator, say, in the order of their times."""
    for sample in sorted(samples, key=lambda each: each.at):
        take(sample)
