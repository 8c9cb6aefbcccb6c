"""Recordings as tests need them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from msgspec import Struct

from poise.wire.recording_file import McapFile


def write_recording(path: Path, robot: str, records: Iterable[Struct] = ()) -> None:
    """Write a recording that was ended; inputs came when they say [s since 1970]."""
    with McapFile(path, robot) as file:
        for number, record in enumerate(records):
            file.add_record(record, getattr(record, "at", float(number)))
