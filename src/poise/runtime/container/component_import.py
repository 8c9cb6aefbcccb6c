"""Imports and constructs a component on a thread of its own; nobody waits for it."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

from poise import threads
from poise.clock import ComponentClock
from poise.priority import give_way
from poise.runtime.component.component import Component
from poise.runtime.component.implementation import find_for, search_first
from poise.runtime.hosting.command_line import CommandLine
from poise.runtime.hosting.output import write_as
from poise.runtime.hosting.runner import Runner
from poise.wire.records.code_records import CODE, PACKAGES
from poise.wire.records.deployment_records import ComponentSpec

CODE_FOLDER = "POISE_CODE"
"""Environment variable: the folder of the versions of code that were sent here."""


def folder_of_version(version: str) -> str:
    """Return where the modules of a version are; search its wheels from now on."""
    place = Path(os.environ.get(CODE_FOLDER, ""), version)
    search_first(str(place / PACKAGES))
    return str(place / CODE)


def implementation_of(spec: ComponentSpec, folder: str) -> type[Component]:
    """Return the class to run."""
    if spec.command:
        own = {
            "command": spec.command,
            "folder": folder or ".",
            "variables": spec.environment,
        }
        return type("CommandLine", (CommandLine,), own)
    return find_for(spec.implementation, spec.parameters, folder)


def prepare(
    spec: ComponentSpec,
    folder: str,
    clock: ComponentClock,
    on_change: Callable[[], None],
    *,
    gives_way: bool,
) -> Future[Runner]:
    """Return what becomes the component, not started yet, or why it is not there."""
    prepared: Future[Runner] = Future()
    prepared.add_done_callback(lambda _: on_change())

    def main() -> None:
        write_as(spec.name)
        threads.take_name(spec.name)  # what it starts is found by it
        if gives_way:
            give_way()
        asked_at = clock.now()
        try:
            runner = Runner(spec, implementation_of(spec, folder), clock, on_change)
            runner.asked_at = asked_at
        # it is the user's: it may raise anything
        except BaseException as error:  # noqa: BLE001
            prepared.set_exception(error)
        else:
            prepared.set_result(runner)

    try:
        threads.daemon(main, f"import {spec.name}").start()
    except RuntimeError as error:  # no thread is free: the other components go on
        prepared.set_exception(error)
    return prepared
