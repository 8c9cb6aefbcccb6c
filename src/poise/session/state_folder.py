"""Where a user's robots leave what outlives them: journals, and logs of managers."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from poise.errors import UsageError

_JOURNAL = "journal.jsonl"


def state_folder() -> Path:
    """Return the folder of this user's robots."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "poise"


def make_journal(robot: str) -> Path:
    """Return the file of a robot's journal, in a folder that is there if possible."""
    path = state_folder() / robot / _JOURNAL
    with contextlib.suppress(OSError):  # the journal itself says that it has none
        path.parent.mkdir(parents=True, exist_ok=True)
    return path


def find_journal(robot: str | None = None) -> Path:
    """Return a robot's journal, or the one written last; UsageError: there is none."""
    found = list(state_folder().glob(f"{robot or '*'}/{_JOURNAL}"))
    if not found:
        of = f" of robot '{robot}'" if robot else ""
        known = sorted(
            each.parent.name for each in state_folder().glob(f"*/{_JOURNAL}")
        )
        raise UsageError(
            f"there is no journal{of} in {state_folder()} (there: "
            f"{', '.join(known) or 'none'}): `poise up` writes one, or name a file"
        )
    return max(found, key=lambda each: each.stat().st_mtime_ns)


def to_write(path: Path | None) -> Path | None:
    """Return a path to be written at the end; UsageError when it cannot be."""
    if path is None:
        return None
    is_new = not path.exists()
    try:
        with path.open("ab"):
            pass
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error
    if is_new:
        path.unlink()
    return path
