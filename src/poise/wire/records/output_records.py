"""What components wrote, and how a manager asks an agent for it."""

from __future__ import annotations

from msgspec import Struct


class ReadOutput(Struct, frozen=True, tag=True, kw_only=True):
    """Tell what was written on a computer."""

    component: str = ""  # Only its lines; empty: all
    after: int = 0  # Only what was written later [ns since 1970]
    most: int = 1_000  # Of more lines than this, only the last


class OutputLine(Struct, frozen=True, kw_only=True):
    """A line that was written to standard output or error, or logged."""

    at: int  # When [ns since 1970], by the clock of its computer
    # Whose thread wrote it; of a call, the caller's. Else the name of the container
    component: str
    text: str
    computer: str = ""


class OutputLines(Struct, frozen=True, tag=True, kw_only=True):
    """Lines, oldest first; `omitted` counts those before, which are over `most`."""

    lines: tuple[OutputLine, ...] = ()
    omitted: int = 0
