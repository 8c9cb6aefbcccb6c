"""Sees which of a robot's native code a computer cannot run: that of other machines."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

_MACHINES = {3: "i686", 40: "armv7l", 62: "x86_64", 183: "aarch64", 243: "riscv64"}
"""The numbers of machines in elf(5), and their names of uname(2)."""
_TAG = re.compile(r"\.cpython-3(\d+)-")
"""In the name of a module that one version of Python imports."""


class _Target(NamedTuple):
    """What a file in machine code is for."""

    machine: str
    python: str  # As in ``3.11``; empty: any

    def __str__(self) -> str:
        """Return it for people."""
        python = f" with Python {self.python}" if self.python else ""
        return f"{self.machine}{python}"


def unfit(files: Mapping[str, Path], platforms: Mapping[str, str]) -> Iterator[str]:
    """Yield sentences on code that computers, on their `platforms`, cannot run."""
    targets: dict[str, list[_Target]] = {}
    for name, path in files.items():
        if (target := _target(name, path)) is not None:
            targets.setdefault(_code(name), []).append(target)
    for computer, platform in platforms.items():
        here = _Target(*platform.split()[:2])
        for code, found in targets.items():
            if here not in found and here._replace(python="") not in found:
                yield (
                    f"{computer} is {here}, and cannot run {code}, which is for "
                    f"{' and '.join(map(str, found))}: build it for {here}, too, and "
                    "put that file next to it"
                )


def _target(name: str, path: Path) -> _Target | None:
    """Return what a file is for; None: it is not in machine code."""
    with path.open("rb") as file:
        head = file.read(20)
    if head[:4] != b"\x7fELF":
        return None
    number = int.from_bytes(head[18:], "little" if head[5] == 1 else "big")
    tag = _TAG.search(name)
    machine = _MACHINES.get(number, f"machine {number}")
    return _Target(machine, f"3.{tag[1]}" if tag else "")


def _code(name: str) -> str:
    """Return what all files of a module share; of a program, its name."""
    folder, slash, last = name.rpartition("/")
    stem = last.partition(".")[0] if last.endswith(".so") else last
    return f"{folder}{slash}{stem}"
