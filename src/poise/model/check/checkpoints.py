"""Checkpoints: only what Poise can ask for its state has some."""

from __future__ import annotations

from collections.abc import Iterator

from poise.model.check.file_paths import components
from poise.model.robot import Robot
from poise.model.yaml.positions import Finding


def check_checkpoints(robot: Robot) -> Iterator[Finding]:
    """Yield command lines with a checkpoint, or whose hangs would be noticed."""
    for path, _, component in components(robot):
        for key in ("checkpoint", "restart_when_hung"):
            if component.command and getattr(component, key):
                yield Finding(
                    (*path, key),
                    f"component '{component.name}' is a command line: Poise neither "
                    f"knows its state nor what it does, so leave out `{key}`",
                )
