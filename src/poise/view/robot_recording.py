"""Records a running robot: what it needs, decides and says, for Foxglove."""

from __future__ import annotations

import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import inf, isfinite
from numbers import Real
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct
from msgspec.structs import asdict

from poise.clock import steady_wall_time, wall_time
from poise.decoding import convert
from poise.errors import PoiseError, RunError
from poise.session import Check, Say, log, nothing
from poise.session.arguments import check_names, check_path, check_type
from poise.session.running_robots.running import (
    JournalEntry,
    NoManager,
    Status,
    connect,
)
from poise.units import counted
from poise.view.foxglove import LOG, base64_of, drawings, is_array, stamp
from poise.view.robot_view import (
    ChainRow,
    ComponentRow,
    ComputerRow,
    ConnectorRow,
    LiveReader,
    Reader,
    TimerRow,
)
from poise.wire.codec import Packed, unpack
from poise.wire.recording_file import MESSAGES, McapFile, Schema, extra, float_as_bytes
from poise.wire.records.request_records import TapReading

MOST_LISTED = 1_000
"""Arrays of more values are written as bytes, with their type and shape, and so is what
JSON does not have."""
_IN_JSON = "biufU"
"""The kinds of NumPy's values that JSON has, those of `f` if they are finite."""


def as_json(value: Any) -> Any:  # noqa: ANN401, any message
    """Return a value as JSON has it: all of it."""
    if isinstance(value, Mapping):
        return {str(name): as_json(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(part) for part in value]
    if isinstance(value, bytes | bytearray | memoryview):
        return base64_of(value)
    if not is_array(value):
        is_lacking = isinstance(value, float) and not isfinite(value)
        return float_as_bytes(value) if is_lacking else value
    if value.size <= MOST_LISTED and _is_in_json(value):
        return value.tolist()
    shape, data = list(value.shape), base64_of(value.tobytes())
    return {"dtype": value.dtype.str, "shape": shape, "data": data}


def _is_in_json(array: Any) -> bool:  # noqa: ANN401, NumPy's
    """Return whether lists in JSON hold all that an array does."""
    has_shape = array.size or array.ndim == 1  # an empty list has one side
    kind = array.dtype.kind
    return has_shape and kind in _IN_JSON and (kind != "f" or (abs(array) < inf).all())


_LOOK_EVERY = 0.25
"""Messages are fetched, and the robot is read, after these times [s]."""
_READ_EVERY = 1.0
_PATIENCE = 10.0
"""A recording ends when no manager has answered for so long [s]."""
_LEVELS = {"wrong": 3, "failed": 4}
_INFO = 2


def schema_of(type_: type[Struct]) -> Schema:
    """Return the schema of a record whose fields are numbers, texts and truths."""
    schema = msgspec.json.schema(type_)["$defs"][type_.__name__]
    parts = schema["properties"].items()
    return {
        "type": "object",
        # what is not known is left out: Foxglove refuses parts that may be null
        "properties": {name: part.get("anyOf", [part])[0] for name, part in parts},
        "title": f"poise.{type_.__name__.removesuffix('Row')}",
    }


def schema_like(value: Mapping[str, Any], title: str) -> Schema:
    """Return the schema of objects that have the same parts as one."""
    return {"title": title, **_object_like(value)}


def _object_like(value: Mapping[str, Any]) -> dict[str, Any]:
    parts = {name: _like(part) for name, part in value.items()}
    return {"type": "object", "properties": {n: p for n, p in parts.items() if p}}


def _like(value: Any) -> dict[str, Any]:  # noqa: ANN401, JSON's
    """Return the schema of a part; empty: there is none."""
    if isinstance(value, Mapping):
        return _object_like(value)
    if isinstance(value, list):
        kinds = {_TYPES.get(type(item), "") for item in value}
        is_one = len(kinds) == 1 and "" not in kinds
        return {"type": "array", "items": _like(value[0])} if is_one else {}
    kind = _TYPES.get(type(value))
    return {"type": kind} if kind else {}


_TYPES = {
    bool: "boolean",
    int: "number",
    float: "number",
    str: "string",
    dict: "object",
}


_ROWS = {
    "computers": schema_of(ComputerRow),
    "components": schema_of(ComponentRow),
    "connectors": schema_of(ConnectorRow),
    "timers": schema_of(TimerRow),
    "chains": schema_of(ChainRow),
}
"""Part of a `RobotView` -> the schema of its rows."""


class RobotRecording(Struct, frozen=True, kw_only=True):
    """What was recorded, and what was not.

    Parameters
    ----------
    file
        Where it is.
    messages
        Topic -> messages in the file.
    left_out
        Connector -> messages that went out and are not in the file.
    interrupted
        Whether `KeyboardInterrupt` ended it.
    """

    file: str
    messages: Mapping[str, int]
    left_out: Mapping[str, int] = {}
    interrupted: bool = False


def record(  # noqa: PLR0913 - each is a choice of the user
    path: Path | str,
    connectors: Iterable[str] = (),
    *,
    every: bool = False,
    robot: str | None = None,
    seconds: float = inf,
    rate: float = 400.0,
    say: Say = log.info,
    check: Check = nothing,
    tell: Callable[[float, str], object] = lambda *_: None,
) -> RobotRecording:
    """Record a running robot as an MCAP file, which Foxglove opens.

    The file is whole also when it ends with an error; a kill loses its last second.

    Parameters
    ----------
    path
        The file; nothing may be there.
    connectors
        Whose messages and calls are recorded: names, or ``component.port`` of an end.
    every
        Whether those of all others are recorded, too, also of such as begin later, but
        for what ROS 2 alone connects.
    robot
        Its name; None: the only one that runs here.
    seconds
        For how long [s]; `KeyboardInterrupt` ends it earlier.
    rate
        Most messages of each connector a second.
    say
        Takes a sentence at every step, and at the end about what was left out.
    check
        Called a few times a second; may raise `KeyboardInterrupt`.
    tell
        Called as often with the time so far [s] and how much is in the file.

    Raises
    ------
    UsageError
        There is no such robot or connector, the file cannot be created, or the extra
        `record` is not installed.
    NoManager
        The robot goes on, and had no manager for 10 s.
    RunError
        The disk is full, or the robot has ended.
    """
    check_path("path", path)
    check_names("connectors", connectors)
    for what, value in (("seconds", seconds), ("rate", rate)):
        check_type(what, value, Real, "a number")
    name = connect(robot).status().robot
    extra("foxglove_schemas_protobuf")  # before there is a file
    recorder = Recorder(name, connectors, rate, say, every=every)
    interrupted, file = False, McapFile(Path(path), name)
    try:
        with file:
            say(f"recording robot '{name}' to {path}")
            recorder.record(file, seconds, check, tell)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        say(f"{file.summary()} in {path}")
        for connector, count in sorted(recorder.missing.items()):
            say(f"{connector}: {counted(count, 'message')} left out")
    return RobotRecording(
        file=str(path),
        messages=file.counts,
        left_out=recorder.missing,
        interrupted=interrupted,
    )


class Recorder:
    """Writes what is seen of a robot into a file.

    There is no queue: what the robot notes between two looks is bounded, and what it
    has no room for is counted in `missing`.
    """

    _file: McapFile

    def __init__(
        self,
        robot: str,
        connectors: Iterable[str],
        rate: float,
        say: Say,
        *,
        every: bool,
    ) -> None:
        self.missing: Counter[str] = Counter()
        """Connector -> messages that went out and are not in the file."""
        self.robot = robot
        self._live = LiveReader(robot)
        self._reader = Reader()
        self._rate = rate
        self._say = say
        self._every = every
        self._time = steady_wall_time()
        self._viewer = secrets.token_hex(8)
        self._latest: dict[str, tuple[int, int]] = {}
        self._behind: dict[str, float] = {}
        """Connector -> how far the clock where it begins is behind the one here [s]."""
        self._manager = ""
        self._last_entry = 0
        self._silent_since: float | None = None
        self._connectors: dict[str, str] = {}
        """Connector -> why there is no answer; empty: there is."""
        self._first = [self._read_messages(connector) for connector in connectors]
        for reading in self._first:
            self._connectors[reading.connector] = ""
        self._left_to_ros2: set[str] = set()

    def record(
        self,
        file: McapFile,
        seconds: float,
        check: Check,
        tell: Callable[[float, str], object],
    ) -> None:
        """Record for some time, or until `check` raises."""
        self._file = file
        began = time.monotonic()
        next_read = began
        while self._first:
            self._write_messages(self._first.pop(0))
        try:
            while (now := time.monotonic()) - began < seconds:
                check()
                if now >= next_read:
                    next_read = now + _READ_EVERY
                    self._read(now)
                self._record_all()
                tell(now - began, file.summary())
                left = began + seconds - time.monotonic()
                time.sleep(min(_LOOK_EVERY, max(0.0, left)))
        except KeyboardInterrupt:
            self._read_last()
            raise
        self._read_last()

    def _record_all(self) -> None:
        if self._silent_since is None:
            for connector in self._connectors:
                self._record_messages(connector)

    def _read_last(self) -> None:
        """Record what came since the last look, from a robot that answered then."""
        if self._silent_since is None:
            self._read(time.monotonic())
            self._record_all()

    def _read(self, now: float) -> None:
        seen = self._live.poll()
        if seen.trouble:
            if self._silent_since is None:
                self._silent_since = now
                self._say(f"no answer, waiting up to {_PATIENCE:g} s: {seen.trouble}")
            elif now - self._silent_since > _PATIENCE:
                if not seen.is_old:  # its agents answer
                    raise NoManager(seen.trouble, seen.status)
                raise RunError(f"robot '{self.robot}' has ended: {seen.trouble}")
            return
        if self._silent_since is not None:
            self._silent_since = None
            self._say(f"robot '{self.robot}' answers again")
        assert seen.status is not None  # noqa: S101, without trouble there is one
        if self._every:
            self._add_connectors(seen.status)
        self._write_rows(seen.status, now)
        self._write_entries(seen.status.manager.key, seen.entries)
        self._file.flush()

    def _add_connectors(self, status: Status) -> None:
        """Record all connectors that there are by now, and say which cannot be."""
        for agent in status.computers.values():
            for container in agent.containers:
                for end in container.connectors:
                    self._connectors.setdefault(end.name, "")
        for name in status.by_ros2:
            if name not in self._left_to_ros2:
                self._left_to_ros2.add(name)
                self._say(
                    f"'{name}' is not recorded: it is made by ROS 2 alone; `ros2 bag "
                    "record` records topics"
                )

    def _write_rows(self, status: Status, now: float) -> None:
        view, at = self._reader.update(status, now), self._time()
        for part, schema in _ROWS.items():
            for row in getattr(view, part):
                known = {n: v for n, v in asdict(row).items() if v is not None}
                self._file.add(f"{part}/{row.name}", schema, at, known)

    def _write_entries(self, manager: str, entries: Sequence[JournalEntry]) -> None:
        """Write the entries since the recording began; each manager has its own."""
        last = entries[-1].number if entries else 0
        if not self._manager:
            self._last_entry = last
        elif manager != self._manager:
            self._last_entry = 0
        self._manager = manager
        for entry in entries:
            if entry.number > self._last_entry:
                self._write_entry(entry)
        self._last_entry = last

    def _write_entry(self, entry: JournalEntry) -> None:
        log = {
            "timestamp": stamp(entry.at),
            "level": _LEVELS.get(entry.kind, _INFO),
            "message": entry.what,
            "name": entry.kind,
            "file": "",
            "line": 0,
            "facts": entry.facts if isinstance(entry.facts, dict) else {},
        }
        step = wall_time() - self._time()
        self._file.add("decisions", LOG, entry.at - step, log)

    def _record_messages(self, connector: str) -> None:
        """Write its messages; say why there are none, and that there are some again."""
        why = ""
        try:
            reading = self._read_messages(connector)
        except PoiseError as error:
            why = str(error)
        else:
            self._write_messages(reading)
        if why != self._connectors[connector]:
            self._connectors[connector] = why
            self._say(why or f"connector '{connector}' is recorded again")

    def _read_messages(self, connector: str) -> TapReading:
        asked = self._time()
        reading = self._live.running.look_at(
            connector,
            self._viewer,
            rate=self._rate,
            is_whole=True,
            latest=self._latest.get(connector, (0, 0)),
        )
        self._latest[reading.connector] = reading.latest
        if reading.at:  # between question and answer: as before, if that can be
            behind = self._behind.get(reading.connector, 0.0)
            least, most = asked - reading.at, self._time() - reading.at
            self._behind[reading.connector] = min(max(behind, least), most)
        return reading

    def _write_messages(self, reading: TapReading) -> None:
        whole = [passed for passed in reading.passed if passed.is_whole]
        behind = self._behind.get(reading.connector, 0.0)
        topic = f"{MESSAGES}/{reading.connector}"
        for passed in whole:
            value = unpack(convert(passed.value, Packed))
            at, plain = passed.at + behind, as_json(value)
            message = plain if isinstance(plain, dict) else {"value": plain}
            is_first = topic not in self._file
            schema = schema_like(message, reading.carries) if is_first else {}
            self._file.add(topic, schema, at, message)
            for drawn in drawings(value, at):
                of_part = f"{drawn.kind}/{reading.connector}/{drawn.part}".rstrip("/")
                self._file.add(of_part, drawn.type, at, drawn.content)
        more = len(reading.times) + reading.missing - len(whole)
        if more:
            self.missing[reading.connector] += more
