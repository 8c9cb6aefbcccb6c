"""Files of cgroups, for both versions."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from poise.emulate.processes import stop


class Files:
    """Operations on cgroup files; tests replace it by a fake kernel."""

    def make(self, folder: Path) -> None:
        """Make a cgroup if it does not exist."""
        folder.mkdir(exist_ok=True)

    def write(self, file: Path, value: object) -> None:
        """Write `value` to `file`; OSError when the kernel refuses."""
        file.write_text(f"{value}\n")

    def read(self, file: Path) -> str:
        """Return the content of `file`."""
        return file.read_text()


def pids(folder: Path) -> list[int]:
    """Return the processes in a cgroup and in those below; none if it is not there."""
    found = []
    for file in [folder / "cgroup.procs", *folder.glob("*/cgroup.procs")]:
        with suppress(OSError):
            found += [int(pid) for pid in file.read_text().split()]
    return found


def table(text: str) -> dict[str, int]:
    """Return the numbers of a file of lines ``name number``."""
    return {name: int(value) for name, value in map(str.split, text.splitlines())}


def lift(folder: str) -> None:
    """Lift a cgroup's quota: even a killed process needs CPU to end.

    OSError when the kernel refuses.
    """
    for name, value in (("cpu.cfs_quota_us", "-1"), ("cpu.max", "max")):
        with suppress(FileNotFoundError), Path(folder, name).open("r+") as file:
            file.write(value)


def remove(path: str) -> None:
    """End every process in a cgroup and remove it, if it exists."""
    lift(path)
    folder = Path(path)
    stop(lambda: pids(folder), ask=0.0)
    with suppress(FileNotFoundError):
        for inner in folder.iterdir():
            if inner.is_dir():
                inner.rmdir()
        folder.rmdir()


def bring_back(path: str) -> None:
    """Move processes from a cgroup back to the one above; remove it."""
    folder = Path(path)
    if not folder.exists():
        return
    control = folder.parent / "cgroup.subtree_control"
    off = [f"-{controller}" for controller in control.read_text().split()]
    control.write_text(" ".join(off))
    for pid in pids(folder):
        with suppress(ProcessLookupError):
            (folder.parent / "cgroup.procs").write_text(str(pid))
    folder.rmdir()
