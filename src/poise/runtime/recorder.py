"""The component that `poise run --record` adds: it writes down what others publish."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

from poise.runtime.component import Component
from poise.runtime.implementation import find_type
from poise.runtime.ports import subscribed
from poise.wire.codec import codec
from poise.wire.recorded import Input

MOST = 1 << 28
"""A recording takes at most so many messages [bytes]; later ones are left out."""
_WAITING = 1_000
"""Messages that may wait at each port; older ones give way, and are counted."""
_LENGTH = 4


class Recorder(Component):
    """Appends messages to a file, each behind its length.

    Its parameters are ``path``, and ``ports``: port -> ``[source, type]``.
    """

    @classmethod
    def __poise_specialised__(
        cls, parameters: Mapping[str, Any], folder: str
    ) -> type[Component]:
        """Return a class that subscribes to what `parameters` say."""
        handlers = {
            name: _handler(name, source, find_type(type_, folder))
            for name, (source, type_) in parameters["ports"].items()
        }
        return type(cls.__name__, (cls,), handlers)

    def configure(self) -> None:
        """Begin the file."""
        self._file: BinaryIO = Path(self.parameters["path"]).open("wb")  # noqa: SIM115, until it is cleaned up
        self._began = time.monotonic()
        self._size = 0
        self._encode = msgspec.msgpack.Encoder().encode

    def cleanup(self) -> None:
        """End the file."""
        self._file.close()

    def note(self, source: str, type_: type, message: object) -> None:
        """Write a message down."""
        body, buffers = codec(type_).encode(message)
        at = time.monotonic() - self._began
        entry = self._encode(Input(source, at, body, b"".join(buffers)))
        self._size += len(entry)
        if self._size > MOST:
            self.measure("left_out", 1)
            return
        self._file.write(len(entry).to_bytes(_LENGTH, "little") + entry)


def _handler(name: str, source: str, type_: type) -> Callable[[Recorder, object], None]:
    def handler(self: Recorder, message: object) -> None:
        self.note(source, type_, message)

    handler.__name__ = name
    handler.__annotations__ = {"message": type_, "return": type(None)}
    return subscribed(keep=_WAITING)(handler)


def read_inputs(path: Path) -> list[Input]:
    """Return what a recorder wrote, oldest first; a cut off end is left out."""
    data = path.read_bytes()
    found, at = [], 0
    decoder = msgspec.msgpack.Decoder(Input)
    while at + _LENGTH <= len(data):
        length = int.from_bytes(data[at : at + _LENGTH], "little")
        entry = data[at + _LENGTH : at + _LENGTH + length]
        at += _LENGTH + length
        if len(entry) == length:
            found.append(decoder.decode(entry))
    return found
