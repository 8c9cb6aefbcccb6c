"""Stops leased commands, which do not look, while their lease has ended."""

from __future__ import annotations

from collections.abc import Iterable

from poise.runtime.hosting.command_line import CommandLine
from poise.runtime.hosting.runner import Runner


def freeze_fenced(runners: Iterable[Runner]) -> None:
    """Stop the processes of those whose lease has ended; let the others go on."""
    for runner in runners:
        command = runner.component
        is_leased = runner.lease is not None and runner.life_cycle.is_at_work
        if is_leased and isinstance(command, CommandLine):
            command.freeze(is_frozen=runner.is_fenced)
