"""Where checkpoints of components are kept, and how copies of them travel."""

from __future__ import annotations

import os
from hashlib import blake2s
from pathlib import Path

from msgspec import Struct

from poise.clock import boot_time

LARGEST = 64 << 20
"""A larger state is not kept [bytes]."""


class CheckpointCopy(Struct, frozen=True, kw_only=True, tag=True):
    """A component's state as its agent keeps it."""

    component: str
    epoch: int
    data: bytes | None  # The content of the file; None: it is the same as before
    age: float  # How old it was when this was sent [s]


def checkpoint_path(folder: Path, component: str, epoch: int) -> Path:
    """Return the file of an incarnation's last checkpoint."""
    name = blake2s(f"{component} {epoch}".encode(), digest_size=8).hexdigest()
    return folder / f"{name}.checkpoint"


def set_age(path: Path, age: float = 0.0) -> None:
    """Set a checkpoint's age [s] by its file's time on `boot_time`."""
    os.utime(path, (boot_time() - age,) * 2)


def age_of(modified: float) -> float:
    """Return a checkpoint's age [s] at least, by the ``st_mtime`` of its file."""
    now = boot_time()
    return now - modified if modified <= now else now
