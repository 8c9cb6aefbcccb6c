"""A file of JSON messages in topics, which Foxglove opens (extra `record`)."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
from msgspec import Struct

from poise.errors import RunError, UsageError
from poise.units import counted, format_bytes

_CHUNK = 256 * 1024
"""So much is compressed and written at a time [bytes]."""
_KEPT_FREE = 16 * 1024 * 1024
"""A disk with less room than this counts as full: what is begun must be ended
[bytes]."""

Schema = Mapping[str, Any]


class McapFile:
    """Writes a new file; it is whole when the ``with`` block is left, however.

    Parameters
    ----------
    path
        Where; nothing may be there.

    Raises
    ------
    UsageError
        It cannot be created, the disk has no room, or mcap is not installed.
    """

    def __init__(self, path: Path) -> None:
        try:
            from mcap.writer import Writer  # noqa: PLC0415, an extra
        except ImportError as error:
            raise UsageError(
                "recording needs mcap: pip install 'poise[record]'"
            ) from error
        self.path = path
        self.counts: Counter[str] = Counter()
        """Topic -> messages written."""
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        try:
            self._file = path.open("xb")
        except OSError as error:
            raise UsageError(f"{path} cannot be created: {error.strerror}") from error
        try:
            self._check_room()
        except RunError as error:
            self._file.close()
            path.unlink()
            raise UsageError(str(error)) from error
        self._writer = Writer(self._file, _CHUNK)
        self._writer.start(profile="", library="poise")

    def add(self, topic: str, schema: Schema, at: float, value: object) -> None:
        """Write a message of a topic; the schema of the first one is that of all.

        Parameters
        ----------
        topic
            Such as ``timers/eye.look``: dots become slashes, for Foxglove takes what
            follows a dot for a field.
        schema
            JSON Schema of an object, with a title of its own.
        at
            When it came to be [s since 1970].

        Raises
        ------
        RunError
            The disk is full.
        """
        topic = _slashed(topic)
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic, "json", self._schema(schema)
            )
        moment = int(at * 1e9)
        data = msgspec.json.encode(value)
        try:
            self._check_room()
            self._writer.add_message(self._channels[topic], moment, data, moment)
        except OSError as error:
            raise RunError(
                f"{self.path} cannot be written: {error.strerror}"
            ) from error
        self.counts[topic] += 1

    def summary(self) -> str:
        """Return how much was written, for people."""
        written = counted(self.counts.total(), "message")
        return f"{written} of {counted(len(self.counts), 'topic')}"

    def __contains__(self, topic: str) -> bool:
        """Return whether the topic has messages."""
        return _slashed(topic) in self._channels

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        _type: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        try:
            with self._file:
                self._writer.finish()
        except OSError as error:
            raise RunError(
                f"{self.path} could not be ended: {error.strerror}; "
                "`mcap recover` makes it whole"
            ) from error

    def _schema(self, schema: Schema) -> int:
        name = str(schema["title"])
        text = json.dumps(schema)
        if text not in self._schemas:
            self._schemas[text] = self._writer.register_schema(
                name, "jsonschema", text.encode()
            )
        return self._schemas[text]

    def _check_room(self) -> None:
        disk = os.fstatvfs(self._file.fileno())
        free = disk.f_bavail * disk.f_frsize
        if free < _KEPT_FREE:
            raise RunError(
                f"{self.path}: the disk is full: {format_bytes(free)} are left, and "
                f"{format_bytes(_KEPT_FREE)} stay free"
            )


def _slashed(topic: str) -> str:
    return "/" + topic.replace(".", "/")


def schema_of(type_: type[Struct]) -> Schema:
    """Return the schema of a record whose fields are numbers, texts and truths."""
    found = msgspec.json.schema(type_)
    return {
        **found["$defs"][type_.__name__],
        "title": f"poise.{type_.__name__.removesuffix('Row')}",
    }


def schema_like(value: Mapping[str, Any], title: str) -> Schema:
    """Return the schema of objects that have the same parts as one.

    Parts of which Foxglove takes no schema are left out of it, and only of it: null,
    and lists that are empty, mixed or of lists.
    """
    return {"title": title, **_object_like(value)}


def _object_like(value: Mapping[str, Any]) -> dict[str, Any]:
    parts = {name: _like(each) for name, each in value.items()}
    return {"type": "object", "properties": {n: p for n, p in parts.items() if p}}


def _like(value: Any) -> dict[str, Any]:  # noqa: ANN401, JSON's
    """Return the schema of a part; empty: there is none."""
    if isinstance(value, Mapping):
        return _object_like(value)
    if isinstance(value, list):
        kinds = {_TYPES.get(type(each), "") for each in value}
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
