"""Keeps a recording of a run: what is used, and what goes between architectures."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path

from msgspec import Struct

from poise.manage.observe.recording import RecordingFile
from poise.model.robot import Robot
from poise.runtime.connectors.recorded_inputs import read_inputs
from poise.session.callbacks import Say
from poise.session.recordings.tapped_robot import Tapped, tapped
from poise.wire.recording_file import Input, Recorded, append


class Kept(Struct, frozen=True):
    """What is to run, and what records it; None: nothing does."""

    robot: Robot
    recorder: RecordingFile | None = None


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
    if file is None:
        yield Kept(robot)
        return
    inputs = file.with_name(f"{file.name}.inputs")
    inputs.unlink(missing_ok=True)
    tap = tapped(robot, placed, inputs)
    recorder = RecordingFile(file, robot.name)
    try:
        yield Kept(tap.robot, recorder)
    finally:
        recorder.close()
        say(str(recorder))
        there = read_inputs(inputs) if inputs.exists() else []
        append(Recorded(robot=robot.name, inputs=there), file)
        inputs.unlink(missing_ok=True)
        say(_summary(there, tap, file))


def _summary(inputs: list[Input], tap: Tapped, file: Path) -> str:
    if not tap.sources and not tap.callers:
        return "nothing goes between architectures"
    if not inputs:
        return f"what came is in {file}.inputs on the robot, if any"
    calls = sum(each.tag is not None for each in inputs)
    messages = len(inputs) - calls
    found = [
        f"{count} {what} of {', '.join(names)}"
        for count, what, names in (
            (messages, "messages", tap.sources),
            (calls, "calls", tap.callers),
        )
        if names
    ]
    return f"recorded {' and '.join(found)} to {file}"
