"""Temporary folders, locked while in use: the next process removes the others."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from hashlib import blake2s
from pathlib import Path

from poise.errors import RunError

_MOST_TRIES = 10


@contextlib.contextmanager
def scratch_folder(prefix: str) -> Iterator[Path]:
    """Make a folder, removed afterwards, and remove unlocked ones of this `prefix`."""
    _sweep(prefix)
    folder, lock = _made(prefix)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def agent_folder(of: str) -> Path:
    """Return the folder of an agent, the same one each time it is started."""
    name = blake2s(of.encode(), digest_size=8).hexdigest()
    folder = Path(tempfile.gettempdir()) / f"poise-agent-{os.getuid()}-{name}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise RunError(f"the folder {folder} is not this user's: choose another")
    return folder


def _made(prefix: str) -> tuple[Path, int]:
    for _ in range(_MOST_TRIES):
        folder = Path(tempfile.mkdtemp(prefix=prefix))
        lock = _lock(folder)
        if lock is None:
            continue
        if folder.exists():
            return folder, lock
        os.close(lock)  # somebody swept before it was locked
    where = tempfile.gettempdir()
    raise RunError(f"no folder in {where} can be locked: choose another by TMPDIR")


def _sweep(prefix: str) -> None:
    for folder in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        lock = _lock(folder)
        if lock is not None:
            shutil.rmtree(folder, ignore_errors=True)
            os.close(lock)


def _lock(folder: Path) -> int | None:
    """Lock a folder of this user's; None when that cannot be, as when it is held."""
    try:
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    with contextlib.suppress(OSError):
        if os.fstat(opened).st_uid == os.getuid():
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return opened
    os.close(opened)
    return None
