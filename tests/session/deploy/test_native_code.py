"""It is said before a robot starts when a computer cannot run its native code."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Literal

import pytest

from poise.session.deploy.native_code import unfit

ARM, X86 = "aarch64 3.11 2.36", "x86_64 3.11 2.36"


def program(machine: int, order: Literal["little", "big"] = "little") -> bytes:
    """Return the head of a program for a machine, as elf(5) has it."""
    kind = 1 if order == "little" else 2
    numbers = (number.to_bytes(2, order) for number in (3, machine))
    return bytes([0x7F, *b"ELF", 2, kind, 1]).ljust(16, b"\0") + b"".join(numbers)


FILES = {
    "pilot.cpython-311-x86_64-linux-gnu.so": program(62),
    "pilot.cpython-311-aarch64-linux-gnu.so": program(183),
    "eyes/lens.cpython-311-x86_64-linux-gnu.so": program(62),
    "eyes/glass.cpython-312-aarch64-linux-gnu.so": program(183),
    "eyes/frame.abi3.so": program(183),
    "bin/drive": program(62),
    "bin/run.sh": b"#!/bin/sh\n",
    "empty.py": b"",
}


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    paths = {name: tmp_path / name for name in FILES}
    for name, path in paths.items():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(FILES[name])
    return paths


def test_code_for_another_machine_or_python_is_told(files: dict[str, Path]) -> None:
    told = list(unfit(files, {"left": ARM, "right": X86}))
    assert [each.partition(", which is for ")[0] for each in told] == [
        "left is aarch64 with Python 3.11, and cannot run eyes/lens",
        "left is aarch64 with Python 3.11, and cannot run eyes/glass",
        "left is aarch64 with Python 3.11, and cannot run bin/drive",
        "right is x86_64 with Python 3.11, and cannot run eyes/glass",
        "right is x86_64 with Python 3.11, and cannot run eyes/frame",
    ]


def test_all_that_a_module_is_for_is_told(files: dict[str, Path]) -> None:
    (pilot, *_) = unfit(files, {"left": "aarch64 3.12 2.36"})
    assert pilot == (
        "left is aarch64 with Python 3.12, and cannot run pilot, which is for x86_64 "
        "with Python 3.11 and aarch64 with Python 3.11: build it for aarch64 with "
        "Python 3.12, too, and put that file next to it"
    )


def test_a_machine_without_a_name_here_is_told_by_its_number(tmp_path: Path) -> None:
    (tmp_path / "drive").write_bytes(program(8, "big"))
    (told,) = unfit({"drive": tmp_path / "drive"}, {"left": ARM})
    assert "which is for machine 8: build" in told


def test_programs_of_this_machine_run_here() -> None:
    python = {"python": Path(sys.executable).resolve()}
    here = os.uname().machine
    assert list(unfit(python, {"here": f"{here} 3.11 2.36"})) == []
    assert len(list(unfit(python, {"there": "vax 3.11 2.36"}))) == 1
