"""Poise's side in C++: ``echo.cpp``, which is built when it is first imported."""

from __future__ import annotations

import importlib
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from benchmarks.calls import container
from benchmarks.calls.systems import bare
from benchmarks.calls.timing import Trips
from poise import cmake

SOURCE = Path(__file__).with_name("echo.cpp")
FOLDER = Path(__file__).parents[2] / "build" / "benchmarks"
_PROJECT = f"""cmake_minimum_required(VERSION 3.18)
project(echo LANGUAGES CXX)
find_package(poise REQUIRED)
poise_add_component(echo SOURCES {SOURCE})
"""


def _built() -> ModuleType:
    """Return the module; ImportError without what builds it."""
    for tool in ("cmake", "c++"):
        if shutil.which(tool) is None:
            raise ImportError(f"no {tool}", name=tool)
    FOLDER.mkdir(parents=True, exist_ok=True)
    project = FOLDER / "CMakeLists.txt"
    if not project.exists():
        project.write_text(_PROJECT)
    where = f"-Dpoise_DIR={cmake.folder()}", f"-DPython_EXECUTABLE={sys.executable}"
    for words in (["-S", ".", "-B", "build", *where], ["--build", "build"]):
        subprocess.run(["cmake", *words], cwd=FOLDER, check=True, capture_output=True)
    sys.path.insert(0, str(FOLDER))
    return importlib.import_module("echo")


echo: Any = _built()


@contextmanager
def direct(folder: Path, caller: Any, callee: Any) -> Iterator[Trips]:
    """Give the round trips within a container; of short calls, those of a batch."""
    with container.connect("direct", folder, caller, callee) as runner:
        component: Any = runner.component
        if caller is echo.Caller:
            yield lambda size, count: component.trips(size, count, bare.BATCH)
        else:
            yield bare.Caller(component.calls).trips


@contextmanager
def local(folder: Path) -> Iterator[Trips]:
    """Give the round trips between containers."""
    with container.connect("local", folder, echo.Caller) as runner:
        component: Any = runner.component
        yield lambda size, count: component.trips(size, count, 1)
