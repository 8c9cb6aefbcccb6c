"""The hash of an architecture: what ran can be told by it later."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

import msgspec
from msgspec.structs import replace

from poise.estimate.profile.code_version import version_of
from poise.model.robot import Architecture

_MOST_FILES = 2000


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
