"""Which code an agent lets a manager run: all, or what is below given folders."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from poise.wire.records.deployment_records import ContainerSpec


def refusal(containers: Sequence[ContainerSpec], allowed: Sequence[str]) -> str:
    """Return what of these containers is not allowed; empty: nothing.

    `allowed`: folders; empty: everything is.
    """
    if not allowed:
        return ""
    for name, path in _places(containers):
        if not any(Path(path).is_relative_to(folder) for folder in allowed):
            return (
                f"{name} is at {path or 'an unknown place'}, and this agent only runs "
                f"what is in {', '.join(allowed)} (`poise agent --allow`)"
            )
    return ""


def _places(containers: Sequence[ContainerSpec]) -> Iterator[tuple[str, str]]:
    """Yield what would run, and where that is; empty: it is not known."""
    for container in containers:
        for folder in (container.folder, *container.repository):
            yield f"code of container '{container.name}'", os.path.normpath(folder)
        for component in container.components:
            if component.command:
                where = _place_of(component.command[0], container.folder)
                yield f"the program of '{component.name}'", where


def _place_of(program: str, folder: str) -> str:
    if "/" in program:
        return os.path.normpath(Path(folder, program))
    return shutil.which(program) or ""
