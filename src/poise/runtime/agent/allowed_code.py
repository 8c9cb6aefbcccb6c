"""Which code an agent lets a manager run: all, or what is deployed or in folders."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from poise.runtime.agent.surroundings import DEPLOYED
from poise.runtime.hosting import command_line
from poise.wire.records.code_records import SHOWN
from poise.wire.records.deployment_records import ContainerSpec


def refusal(
    containers: Sequence[ContainerSpec],
    allowed: Sequence[str],
    there: Collection[str] = (),
) -> str:
    """Return what is not `allowed`, as `AgentSetup.allow` says; empty: nothing."""
    for container in containers:
        if container.code and container.code not in there:
            return (
                f"it does not have version {container.code[:SHOWN]} of the robot's "
                "code: run `poise deploy FILE`"
            )
    for name, path in _places(containers) if allowed else ():
        if not any(Path(path).is_relative_to(place) for place in allowed):
            cure = "; `poise deploy FILE` sends code" if DEPLOYED in allowed else ""
            where = path or "an unknown place"
            return (
                f"{name} is at {where}, and this agent only runs what is "
                f"{_places_named(allowed)} (`poise agent --allow`){cure}"
            )
    return ""


def refusal_of_code(allowed: Sequence[str]) -> str:
    """Return why no code may be sent; empty: it may."""
    if not allowed or DEPLOYED in allowed:
        return ""
    return (
        f"it only runs what is {_places_named(allowed)}: start it with `poise agent "
        f"--allow {DEPLOYED}`, too"
    )


def _places_named(places: Sequence[str]) -> str:
    folders = ", ".join(place for place in places if place != DEPLOYED)
    is_deployed = [DEPLOYED] if DEPLOYED in places else []
    return " or ".join([*is_deployed, *([f"in {folders}"] if folders else [])])


def _places(containers: Sequence[ContainerSpec]) -> Iterator[tuple[str, str]]:
    """Yield what would run, and where that is; empty: it is not known."""
    for container in containers:
        code = f"code of container '{container.name}'"
        if container.code:
            yield code, DEPLOYED
        else:
            for folder in (container.folder, *container.repository):
                yield code, _absolute(folder)
        for component in container.components:
            if component.command:
                where = _place_of(component.command[0], container)
                yield f"the program of '{component.name}'", where


def _place_of(program: str, container: ContainerSpec) -> str:
    if program.startswith("ros2:"):  # an installed one
        with contextlib.suppress(OSError):
            return command_line.program(program, "")
        return ""
    if "/" in program and not program.startswith("/") and container.code:
        inside = os.path.normpath(program)
        return "" if inside.startswith("..") else DEPLOYED
    if "/" in program:
        return _absolute(container.folder, program)
    return shutil.which(program) or ""


def _absolute(*parts: str) -> str:
    """Return a path that is never `DEPLOYED`; links stay as they are."""
    return os.path.abspath(Path(*parts))  # noqa: PTH100
