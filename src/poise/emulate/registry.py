"""The emulations of this user on this machine, on disk.

An emulation is registered before anything of it is made. A killed run cannot clean up;
the next run finds the entry, sees that its owner is dead, and removes what it lists.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from poise.emulate import cgroups as cgroup_files
from poise.emulate import emulated_network
from poise.emulate.layout import EmulationLayout
from poise.emulate.processes import PREFIX, Owner, marked, stop
from poise.errors import PoiseError, RunError, UsageError

FOLDER = "POISE_EMULATIONS"
"""The environment variable that names the registry's folder."""
_LOCK_LIMIT = 30.0
_POLL_EVERY = 0.01


def registry() -> Path:
    """Return the folder of all entries; only this user may write to it."""
    run = "/run" if os.access("/run", os.W_OK) else os.environ.get("XDG_RUNTIME_DIR")
    usual = f"{run}/{PREFIX}" if run else f"/tmp/{PREFIX}-{os.getuid()}"  # noqa: S108 - owner and mode are checked below
    folder = Path(os.environ.get(FOLDER) or usual)
    folder.mkdir(mode=0o700, exist_ok=True)
    owner = folder.lstat()
    if owner.st_uid != os.getuid() or owner.st_mode & 0o022 or folder.is_symlink():
        message = f"{folder} must belong to user {os.getuid()} alone: remove it"
        raise RunError(message)
    return folder


def registered() -> Iterator[EmulationLayout]:
    """Yield all emulations, of living owners and of dead ones."""
    for file in sorted(registry().glob("*.emulation")):
        try:
            yield msgspec.json.decode(file.read_bytes(), type=EmulationLayout)
        except FileNotFoundError:  # another process removed it
            continue
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            message = f"{file}: {error}: sweep with the Poise that wrote it, or remove"
            raise RunError(message) from error


def kept_sets() -> list[EmulationLayout]:
    """Return the emulations of living owners that are up and kept for others."""
    return [
        layout
        for layout in registered()
        if layout.kept and layout.kept.since and layout.owner.is_alive()
    ]


@contextmanager
def locked() -> Iterator[None]:
    """Let no other process of this user change kept sets meanwhile."""
    handle = os.open(registry(), os.O_RDONLY)
    try:
        deadline = time.monotonic() + _LOCK_LIMIT
        while not _is_locked(handle):
            if time.monotonic() > deadline:
                message = (
                    "another command has been changing emulated computers for "
                    f"{_LOCK_LIMIT:g} s: `lsof {registry()}` names its process"
                )
                raise RunError(message)
            time.sleep(_POLL_EVERY)
        yield
    finally:
        os.close(handle)


def register(lay_out: Callable[[Collection[str]], EmulationLayout]) -> EmulationLayout:
    """Lay an emulation out, and write it down, so that `sweep` can find it."""
    with locked():
        layout = lay_out(addresses())
        if layout.kept is not None:
            _raise_if_kept(layout.kept.robot, layout.run)
        write(layout)
    return layout


def addresses(but: str = "") -> list[str]:
    """Return the IP addresses of all emulations but one of this name."""
    others = (layout for layout in registered() if layout.run != but)
    return [computer.address for layout in others for computer in layout.computers]


def read(run: str) -> EmulationLayout | None:
    """Return an emulation by its name; None when it has ended."""
    return next((layout for layout in registered() if layout.run == run), None)


def write(layout: EmulationLayout) -> None:
    """Write an entry, or what has changed in it."""
    # Atomic: a partial entry would hide the rest for ever.
    draft = _entry(layout.run).with_suffix(".draft")
    draft.write_bytes(msgspec.json.encode(layout))
    draft.rename(_entry(layout.run))


def _remove_folder(folder: str) -> None:
    """Remove a folder with all in it; another process may do so at the same time."""
    while Path(folder).is_dir():
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(folder)


def remove(layout: EmulationLayout) -> None:
    """Remove all of an emulation, and then its entry. Repeating it is harmless."""
    network, computers = layout.network, layout.computers
    steps: tuple[tuple[Callable[[str], None], Iterable[str]], ...] = (
        (_end_marked, [computer.mark for computer in computers]),
        (cgroup_files.remove, [folder for c in computers for folder in c.groups]),
        (cgroup_files.bring_back, layout.aside),
        (emulated_network.unplug, [network.owner] if network else []),
        (emulated_network.remove, network.namespaces if network else []),
        (_remove_folder, [computer.folder for computer in computers]),
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
    with locked():  # or a command that changes the entry would bring it back
        _entry(layout.run).unlink(missing_ok=True)


def sweep() -> list[Owner]:
    """Remove emulations whose owner is dead; return those owners."""
    dead = [layout for layout in registered() if not layout.owner.is_alive()]
    return [layout.owner for layout in dead if _sweep(layout)]


def _raise_if_kept(robot: str, run: str) -> None:
    for other in registered():
        is_kept = other.kept is not None and other.kept.robot == robot
        if is_kept and other.run != run and other.owner.is_alive():
            message = (
                f"robot '{robot}' has emulated computers already, of process "
                f"{other.owner.pid}: `poise emulate stop --robot {robot}` ends them"
            )
            raise UsageError(message)


def _is_locked(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


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
