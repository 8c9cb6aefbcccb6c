"""The component that feeds others while they are measured: it plays a workload."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import cycle
from pathlib import Path
from types import GenericAlias
from typing import Any

import msgspec
from msgspec import Struct

from poise.errors import CallError, RobotError
from poise.model.robot import Generated
from poise.runtime.component.component import Component
from poise.runtime.component.implementation import find_function, find_type
from poise.runtime.component.ports import Published, Required, every
from poise.runtime.connectors.interface import methods
from poise.runtime.workload.message_generator import maker
from poise.wire.codec import codec
from poise.wire.recording_file import load
from poise.wire.records.recorded import Input

TICK = 0.005
"""Messages go out at multiples of this [s]."""
_PAUSE = 0.1
"""Between two rounds of a recording [s]."""
Due = tuple[float, Callable[[], None]]
"""When something is to be sent, since the beginning [s], and what sends it."""


class PlayedPort(Struct, frozen=True, kw_only=True):
    """What one port of the player sends: sources of the recording, or generated.

    `type` is the message's, or the interface that is called, as
    ``package.module:Class``.
    """

    type: str
    calls: bool = False
    sources: tuple[str, ...] = ()
    generated: Generated | None = None


class Replay(Component):
    """Publishes and calls as its parameters say.

    These are ``ports`` (port -> `PlayedPort`) and ``recording``, a file.
    A call waits for its answer, so what is due behind it may be late.
    """

    @classmethod
    def __poise_specialised__(
        cls, parameters: Mapping[str, Any], folder: str
    ) -> type[Component]:
        """Return a class that publishes and calls what `parameters` say."""
        parts = parts_of(parameters)
        types = {name: find_type(each.type, folder) for name, each in parts.items()}
        hints = {
            name: GenericAlias(Required if part.calls else Published, (types[name],))
            for name, part in parts.items()
        }
        made = {"__annotations__": hints, "types": types, "folder": folder}
        return type(cls.__name__, (cls,), made)

    types: Mapping[str, type]
    folder: str

    def configure(self) -> None:
        """Read the recording, if there is one."""
        recording = self.parameters.get("recording")
        inputs = load(Path(recording)).inputs if recording else []
        self._streams = [
            self._generated(name, part.generated)
            if part.generated
            else self._recorded(name, part, inputs)
            for name, part in parts_of(self.parameters).items()
        ]

    def activate(self) -> None:
        """Begin with what comes first."""
        self._began = self.clock.now()
        self._due = heapq.merge(*self._streams, key=lambda each: each[0])
        self._next = next(self._due, None)

    @every(TICK)
    def play(self) -> None:
        """Publish and call all that is due."""
        now = self.clock.now() - self._began
        while self._next is not None and self._next[0] <= now:
            _, send = self._next
            self._next = next(self._due, None)
            send()

    def _recorded(
        self, name: str, part: PlayedPort, inputs: list[Input]
    ) -> Iterator[Due]:
        """Yield the messages or calls of a source, again and again."""
        found = [each for each in inputs if each.source in part.sources]
        send = self._call if part.calls else self._publish_recorded
        length = max((each.at for each in inputs), default=0.0) + _PAUSE
        for number, each in enumerate(cycle(found)):
            at = number // len(found) * length + each.at
            yield at, partial(send, name, each)

    def _publish(self, port: str, message: object) -> None:
        getattr(self, port).publish(message)

    def _publish_recorded(self, port: str, recorded: Input) -> None:
        decode = codec(self.types[port]).decode
        self._publish(port, decode(recorded.body, memoryview(recorded.buffers)))

    def _call(self, port: str, recorded: Input) -> None:
        interface = self.types[port]
        method = methods(interface).get(recorded.tag or 0)
        if method is None:
            raise RobotError(
                f"{recorded.source} called a method that {interface.__qualname__} has "
                "no more: record the run again"
            )
        arguments = method.arguments.decode(recorded.body, memoryview(recorded.buffers))
        try:
            getattr(getattr(self, port), method.name)(*arguments)
        except CallError:
            self.measure("failed_calls", 1)

    def _generated(self, name: str, how: Generated) -> Iterator[Due]:
        """Yield generated messages."""
        rng = random.Random(how.seed)  # noqa: S311, it is to be repeatable
        make: Any = maker(self.types[name])
        if how.message:
            make = find_function(how.message, self.folder)
        at = 0.0
        while True:
            is_poisson = how.arrivals == "poisson"
            at += rng.expovariate(how.rate) if is_poisson else 1 / how.rate
            spread = rng.uniform(-how.variation, how.variation)
            message = make(rng, how.size * (1 + spread))
            yield at, partial(self._publish, name, message)


def parts_of(parameters: Mapping[str, Any]) -> dict[str, PlayedPort]:
    """Return what a player's parameters say of its ports."""
    return msgspec.convert(parameters["ports"], dict[str, PlayedPort])
