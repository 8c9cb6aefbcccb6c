"""The version of a component's code, as a fingerprint."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import islice
from os.path import isfile
from pathlib import Path

import msgspec
from msgspec.structs import replace

from poise.model.robot import Architecture, ComponentEntry

_MOST_FILES = 2000


def version_of(component: ComponentEntry, *folders: str) -> str:
    """Return a fingerprint that changes when the component's code does.

    It covers the parameters, the implementation's module and all modules that it
    imports from these folders, the robot's and the repository's, also one in C++; of a
    command, the program and its arguments that are files; of a ROS 2 node, its class
    and its files of parameters. Installed packages are not covered.
    """
    digest = hashlib.sha256()
    digest.update(component.implementation.encode())
    digest.update(msgspec.json.encode([component.command, component.parameters]))
    for _, file in sorted(files_of(component, folders)):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def files_of(
    component: ComponentEntry, folders: Iterable[str]
) -> set[tuple[int, Path]]:
    """Return the files of a component's code, each after the number of its folder."""
    places, node = [Path(folder) for folder in folders], component.ros2
    references = [component.implementation, node.node if node else ""]
    modules = [reference.partition(":")[0] for reference in references if reference]
    words = [*component.command[1:], *(node.params_files if node else ())]
    words += [p if "/" in p else shutil.which(p) or "" for p in component.command[:1]]
    return files_of_modules(modules, places) | {
        (number, folder / word)
        for number, folder in enumerate(places)
        for word in words
        if word and isfile(folder / word)  # noqa: PTH113 - no error for a long one
    }


def files_of_modules(
    modules: Iterable[str], folders: Sequence[Path]
) -> set[tuple[int, Path]]:
    """Return the files of modules, and of all that they import from these folders."""
    files: set[tuple[int, Path]] = set()
    waiting, seen = [*modules], set[str]()
    while waiting and len(files) < _MOST_FILES:
        module = waiting.pop()
        if module in seen:
            continue
        seen.add(module)
        for number, folder in enumerate(folders):
            for file in _sources(module, folder):
                if (number, file) not in files:
                    files.add((number, file))
                    waiting += _imports(file, folder)
    return files


def _sources(module: str, folder: Path) -> Iterator[Path]:
    """Yield the files of a module and of the packages around it, in the folder."""
    for part in module.split("."):
        try:
            names = os.listdir(folder)  # noqa: PTH208, a path of each takes long
        except OSError:  # none of its packages is here
            return
        beginning = f"{part}."
        found = [name for name in names if name.startswith(beginning)]
        found = [n for n in found if n == f"{part}.py" or n.endswith(".so")]
        if part in names:
            found.append(f"{part}/__init__.py")
        for name in found:
            file = folder / name
            if file.is_file():
                yield file
        folder /= part


def _imports(file: Path, folder: Path) -> Iterator[str]:
    """Yield the modules that a file may import; none if it cannot be parsed."""
    for node in _import_statements(file, file.stat().st_mtime_ns):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = _base(node, file, folder)
            # a name imported from a package may be a module
            yield from (f"{base}.{alias.name}".strip(".") for alias in node.names)


@cache
def _import_statements(
    file: Path, _changed: int
) -> tuple[ast.Import | ast.ImportFrom, ...]:
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return ()
    imports = (ast.Import, ast.ImportFrom)
    return tuple(node for node in ast.walk(tree) if isinstance(node, imports))


def _base(node: ast.ImportFrom, file: Path, folder: Path) -> str:
    if not node.level:
        return node.module or ""
    package = file.parent.relative_to(folder).parts
    package = package[: len(package) - node.level + 1]
    return ".".join([*package, *([node.module] if node.module else [])])


def hash_of(architecture: Architecture, folders: Iterable[str]) -> str:
    """Return 12 hexadecimal digits that change when what it runs does.

    They cover its components with their parameters and code, and its connectors. What
    only the planner reads (demands, states, traffic, quality, priority, home) is not
    covered, so a new profile changes nothing. Of an architecture in an installed
    package, the version and the Python files of that package are covered.
    """
    digest, folders = hashlib.sha256(), tuple(folders)
    digest.update(msgspec.json.encode(_what_runs(architecture), order="deterministic"))
    for component in architecture.components:
        digest.update(version_of(component, *folders).encode())
    if architecture.package:
        for file in _installed_files(architecture):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def _what_runs(architecture: Architecture) -> Architecture:
    return replace(
        architecture,
        priority=0,
        quality=1.0,
        success=1.0,
        home=None,
        file="",
        components=tuple(
            replace(component, demand={}, state=0.0, only=())
            for component in architecture.components
        ),
        connectors=tuple(
            replace(connector, overhead=None, message=0.0, rate=0.0, record="")
            for connector in architecture.connectors
        ),
    )


def _installed_files(architecture: Architecture) -> Iterator[Path]:
    """Yield the Python files of the packages that implement an architecture."""
    tops = {
        c.implementation.partition(":")[0].split(".")[0]
        for c in architecture.components
        if c.implementation
    }
    for top in sorted(tops):
        spec = importlib.util.find_spec(top)
        for folder in (spec and spec.submodule_search_locations) or ():
            yield from islice(sorted(Path(folder).rglob("*.py")), _MOST_FILES)
