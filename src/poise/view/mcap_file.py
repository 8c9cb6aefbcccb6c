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
from mcap.writer import Writer
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
        It cannot be created, or the disk has no room.
    """

    def __init__(self, path: Path) -> None:
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
        """Write a message of a topic, whose first message says the schema of all.

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
        topic = "/" + topic.replace(".", "/")
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


def schema_of(type_: type[Struct]) -> Schema:
    """Return the schema of a record whose fields are numbers, texts and truths."""
    found = msgspec.json.schema(type_)
    return {
        **found["$defs"][type_.__name__],
        "title": f"poise.{type_.__name__.removesuffix('Row')}",
    }


def schema_like(value: Any, title: str = "") -> dict[str, Any]:  # noqa: ANN401, JSON's
    """Return the schema of what has the same parts as a JSON value."""
    if isinstance(value, Mapping):
        parts = {name: schema_like(each) for name, each in value.items()}
        found: dict[str, Any] = {"type": "object", "properties": parts}
    elif isinstance(value, list):
        found = {"type": "array"}
        if value:
            found["items"] = schema_like(value[0])
    elif isinstance(value, bool):
        found = {"type": "boolean"}
    elif isinstance(value, int | float):
        found = {"type": "number"}
    else:
        found = {"type": "string"} if isinstance(value, str) else {}
    return {"title": title, **found} if title else found
