"""The emulations of this user on this machine, on disk.

An emulation is registered before anything of it is made. A killed run cannot clean up;
the next run finds the entry, sees that its owner is dead, and removes what it lists.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import msgspec

from poise.emulate.cgroup import files as cgroup_files
from poise.emulate.layout import EmulationLayout
from poise.emulate.network import namespaces
from poise.emulate.owner import PREFIX, Owner
from poise.emulate.processes import marked, stop
from poise.errors import PoiseError, RunError


def registry() -> Path:
    """Return the folder of all entries; only this user may write to it.

    Raises
    ------
    RunError
        It belongs to another user, whose entries would remove things of this one.
    """
    run = "/run" if os.access("/run", os.W_OK) else os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(run) / PREFIX if run else Path(f"/tmp/{PREFIX}-{os.getuid()}")  # noqa: S108 - owner and mode are checked below
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if found.st_uid != os.getuid() or found.st_mode & 0o022 or folder.is_symlink():
        message = f"{folder} must belong to user {os.getuid()} alone: remove it"
        raise RunError(message)
    return folder


def registered() -> Iterator[EmulationLayout]:
    """Yield all emulations, of living owners and of dead ones.

    Raises
    ------
    RunError
        Another version of Poise wrote an entry.
    """
    for file in sorted(registry().glob("*.emulation")):
        try:
            yield msgspec.json.decode(file.read_bytes(), type=EmulationLayout)
        except FileNotFoundError:  # another process removed it
            continue
        except msgspec.MsgspecError as error:
            message = f"{file}: {error}: sweep with the Poise that wrote it, or remove"
            raise RunError(message) from error


def register(layout: EmulationLayout) -> None:
    """Write an emulation down, so that `sweep` can find it."""
    # Atomic: a partial entry would hide the rest for ever.
    draft = _entry(layout.run).with_suffix(".draft")
    draft.write_bytes(msgspec.json.encode(layout))
    draft.rename(_entry(layout.run))


def remove(layout: EmulationLayout) -> None:
    """Remove all of an emulation, and then its entry. Repeating it is harmless.

    Raises
    ------
    RunError
        When something could not be removed; the entry stays for the next attempt.
    """
    network, computers = layout.network, layout.computers
    steps: tuple[tuple[Callable[[str], None], Iterable[str]], ...] = (
        (_end_marked, [computer.mark for computer in computers]),
        (cgroup_files.remove, [each for c in computers for each in c.groups]),
        (cgroup_files.bring_back, layout.aside),
        (namespaces.unplug, [network.owner] if network else []),
        (namespaces.remove, network.namespaces if network else []),
        (shutil.rmtree, [c.folder for c in computers if Path(c.folder).is_dir()]),
    )
    problems: list[str] = []
    for act, things in steps:
        for thing in things:
            try:
                act(thing)
            except (OSError, PoiseError) as error:
                problems.append(f"{thing}: {error}")
    if problems:
        message = "an emulation could not remove: " + "; ".join(problems)
        raise RunError(message)
    _entry(layout.run).unlink(missing_ok=True)


def sweep() -> list[Owner]:
    """Remove emulations whose owner is dead; return those owners.

    Raises
    ------
    RunError
        When something could not be removed.
    """
    dead = [layout for layout in registered() if not layout.owner.is_alive()]
    return [layout.owner for layout in dead if _sweep(layout)]


def _sweep(layout: EmulationLayout) -> bool:
    """Remove an emulation, unless another process does."""
    try:
        with _entry(layout.run).open("rb") as handle:
            # The lock is held during the work; another sweep then skips this entry.
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            remove(layout)
    except (FileNotFoundError, BlockingIOError):
        return False
    return True


def _end_marked(mark: str) -> None:
    stop(lambda: marked(mark), ask=0.0)


def _entry(run: str) -> Path:
    return registry() / f"{run}.emulation"
