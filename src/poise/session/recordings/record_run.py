"""Keeps a recording of a run: what is used, and what goes between architectures."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.manage.observe.sample_recording import RecordingFile
from poise.model.robot import ConnectorEnd, Robot
from poise.runtime.component.implementation import find, search_also
from poise.runtime.component.ports import ports_of
from poise.runtime.connectors.recorded_inputs import read_inputs
from poise.session.callbacks import Say
from poise.wire.recording_file import Input, Recorded, append


class Tapped(Struct, frozen=True):
    """The robot, and which component.port is recorded.

    `sources` publish, `callers` call.
    """

    robot: Robot
    sources: tuple[str, ...] = ()
    callers: tuple[str, ...] = ()


def tapped(robot: Robot, placed: Collection[str], path: Path) -> Tapped:
    """Return the robot with what goes between placed architectures recorded.

    It is written where it comes, a message to several at the first of them, to `path`
    on the computer where that is.
    """
    connectors, sources, callers = [], [], []
    for connector in robot.connectors:
        source, target = connector.between
        is_recorded = False
        if source.component in placed and target.component in placed:
            if interface_type(robot, target):
                callers.append(str(source))
                is_recorded = True
            elif message_type(robot, source) and str(source) not in sources:
                sources.append(str(source))
                is_recorded = True
        record = str(path.absolute()) if is_recorded else ""
        connectors.append(msgspec.structs.replace(connector, record=record))
    noted = msgspec.structs.replace(robot, connectors=tuple(connectors))
    return Tapped(noted, tuple(sources), tuple(callers))


def message_type(robot: Robot, end: ConnectorEnd) -> str:
    """Return the type of a topic's port as package.module:Class; empty: it is none."""
    return _type(robot, end, ("publishes", "subscribes"))


def interface_type(robot: Robot, end: ConnectorEnd) -> str:
    """Return the interface of a port as package.module:Class; empty: it has none."""
    return _type(robot, end, ("requires", "provides"))


def _type(robot: Robot, end: ConnectorEnd, kinds: tuple[str, ...]) -> str:
    component = next(c for c in robot.components() if c.name == end.component)
    if not component.implementation:
        return ""
    search_also(robot.repository)
    port = ports_of(find(component.implementation, robot.folder)).get(end.port)
    if port is None or port.kind not in kinds:
        return ""
    return f"{port.type.__module__}:{port.type.__qualname__}"


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
