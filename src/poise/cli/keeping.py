"""Keeps a recording of a run: what is used, and what goes between architectures."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from msgspec import Struct

from poise.cli.computers import Say
from poise.cli.tapped import RECORDER, Tapped, tapped
from poise.manage.recording import Recording, save
from poise.model.robot import Robot
from poise.runtime.recorder import read_inputs
from poise.wire.recorded import Recorded


class Kept(Struct, frozen=True):
    """What is to run, and who takes its samples."""

    robot: Robot
    placement: Mapping[str, str]
    samples: Recording


@contextlib.contextmanager
def keeping(
    robot: Robot, placement: Mapping[str, str], file: Path | None, say: Say
) -> Iterator[Kept]:
    """Write a recording of what runs within to `file`; None: nothing is kept.

    To be entered before the run is, for the recorder writes until it ends.
    """
    samples = Recording()
    if file is None:
        yield Kept(robot, placement, samples)
        return
    inputs = file.with_name(f"{file.name}.inputs")
    inputs.unlink(missing_ok=True)
    tap = tapped(robot, placement, inputs)
    try:
        yield Kept(tap.robot, tap.placement, samples)
    finally:
        there = read_inputs(inputs) if inputs.exists() else []
        recorded = Recorded(robot=robot.name, samples=samples.take(), inputs=there)
        save(recorded, file)
        inputs.unlink(missing_ok=True)
        say(_said(recorded, tap, file))


def _said(recorded: Recorded, tap: Tapped, file: Path) -> str:
    told = f"recorded {len(recorded.samples)} samples"
    if not tap.sources:
        return f"{told} to {file}; nothing is published between architectures"
    if not recorded.inputs:
        where = tap.placement[RECORDER]
        return f"{told} to {file}; messages are in {file}.inputs on '{where}', if any"
    topics = ", ".join(tap.sources)
    return f"{told} and {len(recorded.inputs)} messages of {topics} to {file}"
