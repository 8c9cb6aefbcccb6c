"""The list of what an emulation makes on the host, and its removal.

The list is written before anything is made. A killed run cannot clean up; the next run
finds its list, sees that its owner is dead, and removes what is listed.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.emulate.cgroup import files as cgroup_files
from poise.emulate.network import namespaces
from poise.emulate.owner import PREFIX, Owner
from poise.emulate.processes import marked, stop
from poise.errors import PoiseError, RunError


class Cleanup(Struct, frozen=True, kw_only=True):
    """Everything that one emulation makes on the host.

    Parameters
    ----------
    run
        Names the list.
    groups
        Cgroup folders; processes in them are ended.
    aside
        Cgroup folders whose processes go back to the folder above.
    interfaces
        The owner's ends of cables.
    namespaces
        Network namespaces, by name.
    folders
        Ordinary folders, removed with their contents.
    marks
        Processes that inherited one of these are ended.
    """

    owner: Owner
    run: str
    groups: tuple[str, ...] = ()
    aside: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()
    namespaces: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    marks: tuple[str, ...] = ()

    @property
    def _list(self) -> Path:
        return registry() / f"{self.run}.json"

    def write_down(self) -> None:
        """Write the list, so that `sweep` can find it."""
        # Atomic: a partial list would hide the rest for ever.
        draft = self._list.with_suffix(".draft")
        draft.write_bytes(msgspec.json.encode(self))
        draft.rename(self._list)

    def lift_quotas(self) -> None:
        """Give all processes the CPU time that they need to end.

        Raises
        ------
        OSError
            The kernel refuses.
        """
        for group in self.groups:
            cgroup_files.lift(Path(group))

    def remove(self) -> None:
        """Remove everything, and then the list. Repeating it is harmless.

        Raises
        ------
        RunError
            When something could not be removed; the list stays for the next attempt.
        """
        problems: list[str] = []
        for act, things in (
            (_end_marked, self.marks),
            (_remove_group, self.groups),
            (_bring_back, self.aside),
            (namespaces.unplug, self.interfaces),
            (namespaces.remove, self.namespaces),
            (shutil.rmtree, filter(os.path.isdir, self.folders)),
        ):
            for thing in things:
                try:
                    act(thing)
                except (OSError, PoiseError) as error:
                    problems.append(f"{thing}: {error}")
        if problems:
            message = "an emulation could not remove: " + "; ".join(problems)
            raise RunError(message)
        self._list.unlink(missing_ok=True)


def registry() -> Path:
    """Return the folder of all lists; only this user may write to it.

    Raises
    ------
    RunError
        It belongs to another user, whose lists would remove things of this one.
    """
    run = "/run" if os.access("/run", os.W_OK) else os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(run) / PREFIX if run else Path(f"/tmp/{PREFIX}-{os.getuid()}")  # noqa: S108 - owner and mode are checked below
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if found.st_uid != os.getuid() or found.st_mode & 0o022 or folder.is_symlink():
        message = f"{folder} must belong to user {os.getuid()} alone: remove it"
        raise RunError(message)
    return folder


def sweep() -> list[Owner]:
    """Clean up after emulations whose owner is dead; return those owners.

    Raises
    ------
    RunError
        When something could not be removed.
    """
    swept = (_sweep(file) for file in sorted(registry().glob("*.json")))
    return [owner for owner in swept if owner]


def _sweep(file: Path) -> Owner | None:
    """Clean up after a list whose owner is dead; return that owner."""
    try:
        with file.open("rb") as handle:
            # The lock is held during the work; another sweep then skips this list.
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            cleanup = msgspec.json.decode(handle.read(), type=Cleanup)
            if cleanup.owner.is_alive():
                return None
            cleanup.remove()
            return cleanup.owner
    except (FileNotFoundError, BlockingIOError):  # another process sweeps
        return None


def _end_marked(mark: str) -> None:
    stop(lambda: marked(mark), ask=0.0)


def _remove_group(folder: str) -> None:
    cgroup_files.remove(Path(folder))


def _bring_back(folder: str) -> None:
    cgroup_files.bring_back(Path(folder))
