"""Keeps a recording of a run: what is used, and what goes between architectures."""

from __future__ import annotations

import contextlib
import shutil
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from os import PathLike
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.errors import PoiseError, UsageError
from poise.manage.observe.sample_recording import RecordingFile
from poise.model.robot import ComponentEntry, ConnectorEnd, Robot
from poise.runtime.component.implementation import find, search_also
from poise.runtime.component.ports import Port, ports_of
from poise.session import Say
from poise.wire.recording_file import inputs_folder, left_inputs


class Tapped(Struct, frozen=True):
    """The robot, and which component.port is recorded, of publishers and of callers."""

    robot: Robot
    sources: tuple[str, ...] = ()
    callers: tuple[str, ...] = ()


def tapped(robot: Robot, placed: Collection[str], path: Path) -> Tapped:
    """Return the robot with what goes between placed architectures recorded.

    It is written where it comes, a message to several at the first of them, into the
    folder `path` on the computer where that is.
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


def coded_ports(robot: Robot, component: ComponentEntry) -> Mapping[str, Port]:
    """Return the ports that a component's class has; none of what has no class."""
    if not component.implementation:
        return {}
    search_also(robot.repository)
    return ports_of(find(component.implementation, robot.folder))


def _type(robot: Robot, end: ConnectorEnd, kinds: tuple[str, ...]) -> str:
    port = coded_ports(robot, robot.component(end.component)).get(end.port)
    if port is None or port.kind not in kinds:
        return ""
    return f"{port.type.__module__}:{port.type.__qualname__}"


def new_recording(path: Path, robot: str) -> RecordingFile:
    """Return what records; the recording before may be of what broke."""
    try:
        if path.is_file():
            path.replace(path.with_stem(f"{path.stem}-before"))
    except OSError as error:
        raise UsageError(f"{path} cannot be renamed: {error.strerror}") from error
    return RecordingFile(path, robot)


class Kept(Struct):
    """What is to run, and what records it; None: nothing does."""

    robot: Robot
    recorder: RecordingFile | None = None
    lacks: str = ""  # after the run: why not all is recorded


@contextlib.contextmanager
def keeping(
    robot: Robot, placed: Collection[str], file: str | PathLike[str] | None, say: Say
) -> Iterator[Kept]:
    """Record what runs in `file`, if there is one, until all containers have ended."""
    if file is None:
        yield Kept(robot)
        return
    path = Path(file)
    inputs = inputs_folder(path)
    shutil.rmtree(inputs, ignore_errors=True)
    tap = tapped(robot, placed, inputs)
    recorder = new_recording(path, robot.name)
    kept = Kept(tap.robot, recorder)
    try:
        yield kept
    finally:
        inputs_said = ""
        try:
            inputs_said = _collect(tap, recorder, path)
        except PoiseError as error:
            kept.lacks = f"{error}; the inputs are in {inputs}"
        recorder.close()
        say(str(recorder))
        say(inputs_said or kept.lacks)
        kept.lacks = recorder.trouble or kept.lacks


def _collect(tap: Tapped, recorder: RecordingFile, path: Path) -> str:
    """Move what containers have recorded into the recording; say what that is."""
    if not tap.sources and not tap.callers:
        return "nothing goes between architectures"
    counts: Counter[bool] = Counter()
    for entry in left_inputs(path):
        recorder.file.add_record(entry, entry.at)
        counts[entry.tag is not None] += 1
    recorder.file.flush()
    if not counts:
        return f"the inputs are in {inputs_folder(path)} on the robot, if any"
    shutil.rmtree(inputs_folder(path))
    said = [
        f"{counts[is_call]} {what} of {', '.join(names)}"
        for is_call, what, names in (
            (False, "messages", tap.sources),
            (True, "calls", tap.callers),
        )
        if names
    ]
    return f"recorded {' and '.join(said)} to {path}"
