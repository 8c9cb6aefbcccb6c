"""A small file of the kernel's that is read again and again."""

from __future__ import annotations

import os
from pathlib import Path

_LARGEST = 65536


class KernelFile:
    """Keeps it open: to open such a file takes ten times as long as to read it.

    Parameters
    ----------
    path
        A file in /proc or of a cgroup.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._fd: int | None = None

    def read(self) -> str:
        """Return what it says now; raises OSError."""
        if self._fd is None:
            self._fd = os.open(self._path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            return os.pread(self._fd, _LARGEST, 0).decode("ascii")
        except OSError:
            self.close()  # it may be another one the next time
            raise

    def close(self) -> None:
        """Close it until it is read again."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None
