"""The component that `poise run --record` adds: it writes down what others publish."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from poise.runtime.component.component import Component
from poise.runtime.component.implementation import find_type
from poise.runtime.component.ports import subscribed
from poise.runtime.connectors.recorded_inputs import InputFile, end_to_end
from poise.wire.codec import codec
from poise.wire.records.recorded import Input

_WAITING = 1_000
"""Messages that may wait at each port; older ones give way, and are counted."""


class Recorder(Component):
    """Appends messages to a file.

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
        """Begin to write."""
        self._file = InputFile(Path(self.parameters["path"]))

    def cleanup(self) -> None:
        """End the file."""
        self._file.close()

    def note(self, source: str, type_: type, message: object) -> None:
        """Write a message down."""
        body, buffers = codec(type_).encode(message)
        entry = Input(source, time.monotonic(), body, end_to_end(buffers))
        if not self._file.add(entry):
            self.measure("left_out", 1)


def _handler(name: str, source: str, type_: type) -> Callable[[Recorder, object], None]:
    def handler(self: Recorder, message: object) -> None:
        self.note(source, type_, message)

    handler.__name__ = name
    handler.__annotations__ = {"message": type_, "return": type(None)}
    return subscribed(keep=_WAITING)(handler)
