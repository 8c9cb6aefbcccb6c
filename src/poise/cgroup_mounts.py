"""Where cgroups are mounted, of both versions."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from msgspec import Struct

NO_LIMIT = 1 << 60
"""A memory limit from this on is none [bytes]."""


class Mount(Struct, frozen=True):
    """A mounted cgroup hierarchy, and the folder in it that this process is in."""

    version: int
    top: Path
    own: Path
    controllers: frozenset[str]


def mounts(
    mountinfo: Path = Path("/proc/self/mountinfo"),
    cgroup: Path = Path("/proc/self/cgroup"),
) -> list[Mount]:
    """Return the cgroup hierarchies that are mounted, as proc(5) describes them."""
    entries = [line.split(":", 2) for line in cgroup.read_text().splitlines()]
    paths = {frozenset(names.split(",")): path for _, names, path in entries}
    return list(_mounts(mountinfo.read_text().splitlines(), paths))


def memory_group(proc: Path = Path("/proc")) -> Mount | None:
    """Return the hierarchy that counts this process's memory; None: none does."""
    found: list[Mount] = []
    with contextlib.suppress(OSError):
        found = mounts(proc / "self/mountinfo", proc / "self/cgroup")
    files = ("memory.events", "memory.oom_control")
    return next((m for m in found if any((m.own / f).exists() for f in files)), None)


def _mounts(lines: Sequence[str], paths: dict[frozenset[str], str]) -> Iterator[Mount]:
    for line in lines:
        before, _, after = line.partition(" - ")
        kind, _, options = after.split(" ", 2)
        root, top = before.split()[3], Path(before.split()[4])
        if kind == "cgroup2":
            own = _below(top, root, paths.get(frozenset([""]), "/"))
            names = _words(own / "cgroup.controllers")
            yield Mount(2, top, own, names)
        elif kind == "cgroup":
            names = frozenset(options.split(","))
            mine = [path for key, path in paths.items() if key <= names]
            yield Mount(1, top, _below(top, root, mine[0] if mine else "/"), names)


def _below(top: Path, root: str, path: str) -> Path:
    own = top / path.removeprefix(root).lstrip("/")
    # In a container, the path may be the host's and mean nothing here.
    return own if own.is_dir() else top


def _words(file: Path) -> frozenset[str]:
    return frozenset(file.read_text().split()) if file.exists() else frozenset()
