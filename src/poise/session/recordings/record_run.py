"""Keeps a recording of a run: what is used, and what goes between architectures."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path

from msgspec import Struct

from poise.manage.observe.recording import Recording, save
from poise.model.robot import Robot
from poise.runtime.connectors.recorded_inputs import read_inputs
from poise.session.callbacks import Say
from poise.session.recordings.tapped_robot import Tapped, tapped
from poise.wire.records.recorded import Recorded


class Kept(Struct, frozen=True):
    """What is to run, and who takes its samples."""

    robot: Robot
    samples: Recording


@contextlib.contextmanager
def keeping(
    robot: Robot, placed: Collection[str], file: Path | None, say: Say
) -> Iterator[Kept]:
    """Write a recording of what runs within to `file`; None: nothing is kept.

    To be entered before the run is, for containers write until it ends.

    Parameters
    ----------
    placed
        The components that run.
    """
    samples = Recording()
    if file is None:
        yield Kept(robot, samples)
        return
    inputs = file.with_name(f"{file.name}.inputs")
    inputs.unlink(missing_ok=True)
    tap = tapped(robot, placed, inputs)
    try:
        yield Kept(tap.robot, samples)
    finally:
        there = read_inputs(inputs) if inputs.exists() else []
        recorded = Recorded(robot=robot.name, samples=samples.take(), inputs=there)
        save(recorded, file)
        inputs.unlink(missing_ok=True)
        say(_summary(recorded, tap, file))


def _summary(recorded: Recorded, tap: Tapped, file: Path) -> str:
    samples = f"recorded {len(recorded.samples)} samples"
    if not tap.sources and not tap.callers:
        return f"{samples} to {file}; nothing goes between architectures"
    if not recorded.inputs:
        return (
            f"{samples} to {file}; what came is in {file}.inputs on the robot, if any"
        )
    calls = sum(each.tag is not None for each in recorded.inputs)
    messages = len(recorded.inputs) - calls
    found = [
        f"{count} {what} of {', '.join(names)}"
        for count, what, names in (
            (messages, "messages", tap.sources),
            (calls, "calls", tap.callers),
        )
        if names
    ]
    return f"{samples}, {' and '.join(found)} to {file}"
