"""The folders of a user's robots: journals and logs that stay, and temporary ones."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from hashlib import blake2s
from pathlib import Path

from poise.errors import RunError, UsageError
from poise.user_folders import home_folder, temporary_folder

_JOURNAL, _GIVEN = "journal.jsonl", "journal-given"


def state_folder() -> Path:
    """Return the folder of this user's robots."""
    state = os.environ.get("XDG_STATE_HOME") or home_folder() / ".local" / "state"
    return Path(state) / "poise"


def make_journal(robot: str, given: Path | None = None) -> Path:
    """Return the file of a robot's journal, in a folder that is there if possible.

    A `given` one is linked there, for `find_journal`.
    """
    path = state_folder() / robot / _JOURNAL
    with contextlib.suppress(OSError):  # the journal itself says that it has none
        path.parent.mkdir(parents=True, exist_ok=True)
        if given is not None:
            link = path.with_name(_GIVEN)
            link.unlink(missing_ok=True)
            link.symlink_to(given.absolute())
    return given or path


def find_journal(robot: str | None = None) -> Path:
    """Return a robot's journal, or the one written last; UsageError: there is none.

    Its folder has the robot's name; a given one is a link there.
    """
    every = [p for n in (_JOURNAL, _GIVEN) for p in state_folder().glob(f"*/{n}")]
    known = [path for path in every if os.access(path, os.F_OK)]  # it can be reached
    found = [path for path in known if robot in {None, path.parent.name}]
    if not found:
        of = f" of robot '{robot}'" if robot else ""
        names = ", ".join(sorted({path.parent.name for path in known})) or "none"
        raise UsageError(
            f"there is no journal{of} in {state_folder()} (there: {names}): its "
            "manager writes one, on the computer that `poise status` names, or name a "
            "file"
        )
    # of links to one file, the one that was made last
    return max(found, key=lambda p: (p.stat().st_mtime_ns, p.lstat().st_mtime_ns))


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


def make_folder(path: Path) -> Path:
    """Return a folder to write into, made if need be; UsageError when it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{path} cannot be a folder: {error.strerror}") from error
    return path


def write_whole(path: Path, text: str) -> None:
    """Write a text file whole or not at all; owner, rights and links to it stay.

    A device or a pipe, such as ``/dev/stdout``, is written to. RunError: it cannot be
    written, and is what it was.
    """
    try:
        if path.exists() and not path.is_file():
            path.write_text(text, "utf-8", newline="")
            return
        target = path.resolve()
        new = target.with_name(f".{target.name}.new")
        try:
            new.write_text(text, "utf-8", newline="")
            if target.exists():
                before = target.stat()
                with contextlib.suppress(PermissionError):  # it is another user's
                    os.chown(new, before.st_uid, before.st_gid)
                new.chmod(before.st_mode & 0o7777)
            new.replace(target)
        finally:
            new.unlink(missing_ok=True)
    except OSError as error:
        raise RunError(f"{path} cannot be written: {error.strerror}") from error


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
    folder = temporary_folder() / f"poise-agent-{os.getuid()}-{name}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise RunError(f"the folder {folder} is not this user's: choose another")
    return folder


def system_agent_folder(robot: str, computer: str) -> Path:
    """Return the folder of an agent of root's, in one that all users can enter."""
    top = Path("/var/lib/poise")
    try:
        top.mkdir(exist_ok=True)
        top.chmod(0o711)
    except OSError as error:
        raise UsageError(f"{top}: {error.strerror}: choose another folder") from error
    return top / f"{robot}-{computer}"


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
