"""Recordings: MCAP files, which Foxglove opens (extra `record`).

A recording that was killed ends with its last whole record, and is read as far as that.
"""

from __future__ import annotations

import base64
import contextlib
import errno
import json
import logging
import os
import struct
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib import import_module
from math import inf, isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import msgspec
from msgspec import Struct

from poise.decoding import from_json, msgpack_decoder
from poise.errors import RunError, UsageError
from poise.units import counted, format_bytes
from poise.wire.codec import MALFORMED
from poise.wire.records.status_records import AgentSample

if TYPE_CHECKING:
    from google.protobuf.descriptor import FileDescriptor
    from google.protobuf.message import Message
    from mcap.records import McapRecord

log = logging.getLogger(__name__)

_CHUNK = 1 << 20
"""At most so much is compressed and written at a time [bytes]."""
_KEPT_FREE = 16 << 20
"""A disk with less room than this counts as full: what is begun must be ended
[bytes]."""
_LIBRARY = "poise"
_MAGIC = b"\x89MCAP0\r\n"
"""How a file begins, and ends once it was closed."""

Schema = Mapping[str, Any]


class Input(Struct, frozen=True, array_like=True):
    """A message that was published, or a call that came.

    `source`: ``component.port`` that published it, or that called.
    `at`: when it came [s]: since 1970 in a file, since the first one once read.
    `body`, `buffers`: it, or the arguments, encoded (`poise.wire.codec`); buffers end
    to end.
    `tag`: of a call: which method (`poise.runtime.connectors.interface`).
    `result`: what a call returned, encoded without its arrays; empty: it failed, or
    nobody waited for it.
    """

    source: str
    at: float
    body: bytes
    buffers: bytes
    tag: int | None = None
    result: bytes = b""


_SAMPLES, _INPUTS = "samples", "inputs"
MESSAGES = "messages"
"""The topics of what went out over connectors."""
SEEN = "policies"
"""The topic of what policies see."""
_Record = TypeVar("_Record", bound=Struct)


def message_of(record: Struct) -> tuple[str, bytes]:
    """Return the topic of a record, and how it is written."""
    match record:
        case AgentSample(computer=name):
            topic = f"{_SAMPLES}/{name}"
        case Input(source=name):
            topic = f"{_INPUTS}/{name}"
        case _:
            topic = SEEN
    return topic, msgspec.msgpack.encode(record)


class McapFile:
    """Writes an MCAP file, from any thread; whole when the ``with`` block is left.

    `at_once`, a message is in the file when `add` returns, else after a `flush`.
    """

    def __init__(
        self, path: Path, robot: str, *, at_once: bool = False, replaces: bool = False
    ) -> None:
        writer = extra("mcap.writer")
        self.path = path
        self.counts: Counter[str] = Counter()
        """Topic -> messages written."""
        self._at_once = at_once
        self._channels: dict[str, int] = {}
        self._schemas: dict[bytes, int] = {}
        self._lock = threading.Lock()
        try:
            flags = os.O_WRONLY | os.O_CREAT | (os.O_TRUNC if replaces else os.O_EXCL)
            self._file = os.fdopen(os.open(path, flags, 0o600), "wb")
        except OSError as error:
            raise UsageError(f"{path} cannot be created: {error.strerror}") from error
        self._writer = writer.Writer(self._file, _CHUNK, use_chunking=not at_once)
        try:
            self._check_room()
            self._writer.start(profile="", library=_LIBRARY)
            self._writer.add_metadata(_LIBRARY, {"robot": robot})
            self._writer.flush()
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.close()
            path.unlink()
            raise UsageError(str(self._unwritten(error))) from error

    def add(
        self,
        topic: str,
        schema: Schema | type[Message] | None,
        at: float,
        value: Any,  # noqa: ANN401, as the schema says
    ) -> None:
        """Write what came `at` [s since 1970]: msgpack as bytes, protobuf or JSON.

        Dots in the topic become slashes, for Foxglove takes what follows a dot for a
        field. A topic has the schema of its first message.
        """
        name, topic, moment = topic, _slashed(topic), int(at * 1e9)
        if isinstance(schema, type):
            encoding, data = "protobuf", schema(**value).SerializeToString()
        elif isinstance(value, bytes):
            encoding, data = "msgpack", value
        else:
            encoding, data = "json", msgspec.json.encode(value)
        with self._lock:
            if self._file.closed:
                raise RunError(f"{self.path} is closed")
            try:
                self._check_room()
                if topic not in self._channels:
                    self._channels[topic] = self._writer.register_channel(
                        topic, encoding, self._schema(schema), {"name": name}
                    )
                self._writer.add_message(self._channels[topic], moment, data, moment)
                if self._at_once:
                    self._writer.flush()
            except OSError as error:
                raise self._unwritten(error) from error
            self.counts[topic] += 1

    def add_record(self, record: Struct, at: float) -> None:
        """Write a record that `messages_of` reads."""
        topic, data = message_of(record)
        self.add(topic, None, at, data)

    def flush(self) -> None:
        """Put into the file what was added."""
        with self._lock:
            try:
                self._writer.flush()
            except OSError as error:
                raise self._unwritten(error) from error

    def summary(self) -> str:
        """Return how much was written, for people."""
        written = counted(self.counts.total(), "message")
        return f"{written} of {counted(len(self.counts), 'topic')}"

    def close(self) -> None:
        """Write the index; harmless when repeated."""
        with self._lock:
            if self._file.closed:
                return
            try:
                with self._file:
                    self._writer.finish()
            except OSError as error:
                raise RunError(
                    f"{self.path} could not be ended: {error.strerror}; "
                    "`mcap recover` makes it whole"
                ) from error

    def __contains__(self, topic: str) -> bool:
        """Return whether the topic has messages."""
        return _slashed(topic) in self._channels

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _schema(self, schema: Schema | type[Message] | None) -> int:
        if isinstance(schema, type):
            title, encoding = schema.DESCRIPTOR.full_name, "protobuf"
            text = _file_descriptors(schema)
        elif schema:
            title, encoding = str(schema["title"]), "jsonschema"
            text = json.dumps(schema).encode()
        else:
            return 0
        if text not in self._schemas:
            self._schemas[text] = self._writer.register_schema(title, encoding, text)
        return self._schemas[text]

    def _check_room(self) -> None:
        disk = os.fstatvfs(self._file.fileno())
        free = disk.f_bavail * disk.f_frsize
        if free < _KEPT_FREE:
            why = f"{format_bytes(free)} are left, and {format_bytes(_KEPT_FREE)}"
            raise OSError(errno.ENOSPC, f"the disk is full: {why} stay free")

    def _unwritten(self, error: OSError) -> RunError:
        return RunError(f"{self.path} cannot be written: {error.strerror}")


def robot_of(path: Path) -> str:
    """Return the name of the recorded robot; UsageError: it is no recording."""
    for record in _records(path):
        if type(record).__name__ == "Metadata" and record.name == _LIBRARY:
            return str(record.metadata.get("robot", ""))
    raise UsageError(f"{path} is not a recording of Poise")


def check_recorded(path: Path, robot: str) -> None:
    """Raise UsageError when another robot was recorded, or nothing."""
    if (recorded := robot_of(path)) != robot:
        raise UsageError(f"{path} was recorded of robot '{recorded}', not of '{robot}'")


def samples_of(path: Path) -> Iterator[AgentSample]:
    """Yield what agents counted; UsageError: it is no recording."""
    return messages_of(path, _SAMPLES, AgentSample)


class Said(Struct, frozen=True):
    """A message or call that `poise record` wrote: over which connector, when [s]."""

    connector: str
    at: float
    value: Any


def float_as_bytes(number: float) -> dict[str, Any]:
    """Return what stands for infinity or NaN, which JSON lacks: an array of one."""
    data = struct.pack("<d", nan if isnan(number) else number)
    return {"dtype": "<f8", "shape": [], "data": base64.b64encode(data).decode()}


_NOT_IN_JSON = [(float_as_bytes(number), number) for number in (inf, -inf, nan)]


def _with_floats(value: Any) -> Any:  # noqa: ANN401, JSON's
    """Return a value that was read, with the numbers that JSON lacks."""
    if isinstance(value, list):
        return [_with_floats(part) for part in value]
    if not isinstance(value, dict):
        return value
    for written, number in _NOT_IN_JSON:
        if value == written:
            return number
    return {name: _with_floats(part) for name, part in value.items()}


def said_in(path: Path, *, warns: bool = True) -> Iterator[Said]:
    """Yield messages and calls as they went out; UsageError: it is no recording."""
    connectors: dict[int, str] = {}
    for record in _records(path, warns=warns):
        match type(record).__name__:
            case "Channel":
                kind, _, name = record.metadata.get("name", "").partition("/")
                if kind == MESSAGES:
                    connectors[record.id] = name
            case "Message" if record.channel_id in connectors:
                try:
                    value = _with_floats(from_json(record.data, Any))
                except MALFORMED as error:
                    raise UsageError(f"{path} is damaged: {error}") from error
                at = record.log_time / 1e9
                yield Said(connectors[record.channel_id], at, value)


def inputs_of(path: Path) -> list[Input]:
    """Return messages and calls, oldest first, the first at 0 s.

    Also those that a killed run left in its folder of inputs.
    """
    inputs = [*stored_inputs(path), *left_inputs(path)]
    inputs.sort(key=lambda entry: entry.at)
    return [msgspec.structs.replace(e, at=e.at - inputs[0].at) for e in inputs]


def left_inputs(path: Path) -> Iterator[Input]:
    """Yield what containers have recorded that is not yet in the recording itself."""
    for file in sorted(inputs_folder(path).glob("*.mcap")):
        yield from stored_inputs(file)


def stored_inputs(path: Path) -> Iterator[Input]:
    """Yield the messages and calls in one file as they were written."""
    return messages_of(path, _INPUTS, Input)


def inputs_folder(path: Path) -> Path:
    """Return where containers record messages and calls while a run goes on."""
    return path.with_name(f"{path.name}.inputs")


def messages_of(path: Path, kind: str, type_: type[_Record]) -> Iterator[_Record]:
    """Yield the records in the topics of a kind; UsageError: it is no recording."""
    decoder = msgpack_decoder(type_)
    wanted: set[int] = set()
    for record in _records(path):
        match type(record).__name__:
            case "Channel" if record.topic.split("/")[1:2] == [kind]:
                wanted.add(record.id)
            case "Message" if record.channel_id in wanted:
                try:
                    yield decoder.decode(record.data)
                except MALFORMED as error:
                    raise UsageError(f"{path} is damaged: {error}") from error


def _records(path: Path, *, warns: bool = True) -> Iterator[McapRecord]:
    """Yield the records of a file; `warns`: say when it was not ended."""
    reader, errors = extra("mcap.stream_reader"), extra("mcap.exceptions")
    is_recording, is_whole = False, False
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            file.seek(max(0, size - len(_MAGIC)))
            is_whole = file.read() == _MAGIC
            file.seek(0)
            stream = reader.StreamReader(
                _Whole(file), validate_crcs=True, record_size_limit=size
            )
            for record in stream.records:
                is_recording = True
                yield record
    except OSError as error:
        why = error.strerror or error
        raise UsageError(f"recording {path} cannot be read: {why}") from error
    except errors.McapError as error:
        if not is_recording:
            raise UsageError(
                f"{path} is not a recording: it is not an MCAP file"
            ) from error
        if is_whole:
            why = str(error) or "it ends amid a record"
            raise UsageError(f"{path} is damaged: {why}") from error
        log.log(
            logging.WARNING if warns else logging.DEBUG,
            "the recording %s was not closed: its end is missing (of a robot that was "
            "killed, up to a second)",
            path,
        )
    except Exception as error:  # the library says what its libraries raise
        why = f"{type(error).__name__}: {error}"
        raise UsageError(f"{path} is damaged: {why}") from error


class _Whole:
    """A file of which a part that is cut off counts as its end."""

    def __init__(self, file: Any) -> None:  # noqa: ANN401, what `open` returns
        self._file = file

    def read(self, length: int) -> bytes:
        data: bytes = self._file.read(length)
        return data if len(data) == length else b""


def _file_descriptors(type_: type[Message]) -> bytes:
    """Return a type, and all types in it, as a ``FileDescriptorSet``."""

    def needed(file: FileDescriptor) -> Iterator[FileDescriptor]:
        for other in file.dependencies:
            yield from needed(other)
        yield file

    described = extra("google.protobuf.descriptor_pb2").FileDescriptorSet()
    for file in dict.fromkeys(needed(type_.DESCRIPTOR.file)):
        file.CopyToProto(described.file.add())
    return bytes(described.SerializeToString())


def extra(module: str) -> Any:  # noqa: ANN401, of a library without types
    """Return a module of what recordings need; UsageError: it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise UsageError(
            f"recording needs {library}: pip install 'poise[record]'"
        ) from error


def _slashed(topic: str) -> str:
    return "/" + topic.replace(".", "/")
