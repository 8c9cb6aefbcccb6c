"""Where checkpoints of components are kept, and how copies of them travel."""

from __future__ import annotations

from hashlib import blake2s
from pathlib import Path

from msgspec import Struct

LARGEST = 64 << 20
"""A larger state is not kept [bytes]."""


class CheckpointCopy(Struct, frozen=True, kw_only=True, tag=True):
    """A component's state as its agent keeps it.

    Parameters
    ----------
    data
        The content of the file; None: it is the same as before.
    age
        How old it was when this was sent [s].
    """

    component: str
    epoch: int
    data: bytes | None
    age: float


def checkpoint_path(folder: Path, component: str, epoch: int) -> Path:
    """Return the file of an incarnation's last checkpoint."""
    name = blake2s(f"{component} {epoch}".encode(), digest_size=8).hexdigest()
    return folder / f"{name}.checkpoint"
