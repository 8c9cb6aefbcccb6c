"""The process that owns an emulation."""

from __future__ import annotations

import os
import re
from pathlib import Path

from msgspec import Struct

PREFIX = "poise"


class Owner(Struct, frozen=True):
    """A process: its number and when it started [clock ticks since the machine booted].

    Process numbers are reused, so the number alone does not identify the owner.
    """

    pid: int
    started: int

    @classmethod
    def this(cls) -> Owner:
        """Return the calling process."""
        return cls(os.getpid(), _started(os.getpid()) or 0)

    def is_alive(self) -> bool:
        """Return whether this process still runs."""
        return _started(self.pid) == self.started

    def __str__(self) -> str:
        return f"{PREFIX}-{self.pid}-{self.started}"


def _started(pid: int) -> int | None:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return None
    # The second field is the program's name in brackets and may hold blanks.
    fields = re.sub(r"^.*\) ", "", stat, flags=re.DOTALL).split()
    state, start_time = fields[0], fields[19]
    return None if state in "ZX" else int(start_time)
