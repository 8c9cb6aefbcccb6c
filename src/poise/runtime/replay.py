"""The component that feeds others while they are measured: it plays a workload."""

from __future__ import annotations

import enum
import heapq
import random
import types
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import cycle
from pathlib import Path
from types import GenericAlias
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Struct

from poise.decoding import convert
from poise.errors import CallError, RobotError, UsageError
from poise.model.robot import Generated
from poise.runtime.component.component import Component
from poise.runtime.component.implementation import find_function, find_type
from poise.runtime.component.ports import Published, Required, every
from poise.runtime.connectors.interface import methods
from poise.wire.codec import codec, without_alias
from poise.wire.recording_file import Input, inputs_of

Maker = Callable[[random.Random, float], Any]
"""Makes a message of about this encoded size [bytes]."""

_TRIES = 3
_HALF = 0.5
_SMALL = 100
"""Integers are smaller, so that all take one byte."""


def maker(type_: Any) -> Maker:  # noqa: ANN401, any type of a message
    """Return what makes messages of a type; one field is as long as they need."""
    size_of = codec(type_).size_of

    def make(rng: random.Random, size: float) -> Any:  # noqa: ANN401, of `type_`
        room = 0
        made = _Filling(rng, room).value(type_, type_.__qualname__)
        for _ in range(_TRIES):  # what an element takes shows in what came out
            missing = size - size_of(made)
            if abs(missing) < 1:
                break
            room = max(0, room + round(missing))
            made = _Filling(rng, room).value(type_, type_.__qualname__)
        return made

    try:
        make(random.Random(0), 0.0)  # noqa: S311, to see whether it can be made at all
    except RecursionError:
        raise UsageError(_cannot(type_.__qualname__, "it has itself inside")) from None
    return make


class _Filling:
    """Makes one message; the first field of any length gets `room` [bytes]."""

    def __init__(self, rng: random.Random, room: int) -> None:
        self._rng = rng
        self._room = room

    def value(self, hint: Any, where: str) -> Any:  # noqa: ANN401, PLR0911, any type
        hint = without_alias(hint)
        origin, arguments = get_origin(hint), get_args(hint)
        if origin is Literal:
            return arguments[0]
        if origin in (Union, types.UnionType):
            return self.value(next(a for a in arguments if a is not type(None)), where)
        if hasattr(hint, "__metadata__"):
            return self.value(arguments[0], where)
        if origin is not None and origin.__name__ == "ndarray":
            return self._array(arguments, where)
        if origin in (list, tuple, set, frozenset):
            return self._several(origin, arguments, where)
        plain = origin or hint
        if not isinstance(plain, type):
            raise UsageError(_cannot(where, hint))
        if issubclass(plain, msgspec.Struct):
            hints = get_type_hints(plain, include_extras=True)
            fields = msgspec.structs.fields(plain)
            return plain(
                **{
                    f.name: self.value(hints[f.name], f"{where}.{f.name}")
                    for f in fields
                }
            )
        return self._plain(plain, where)

    def _plain(self, type_: type, where: str) -> Any:  # noqa: ANN401, of `type_`
        if issubclass(type_, enum.Enum):
            return next(iter(type_))
        made: dict[type, Callable[[], Any]] = {
            bool: lambda: self._rng.random() < _HALF,
            int: lambda: self._rng.randrange(_SMALL),
            float: self._rng.random,
            str: lambda: "a" * self._claim_room(),
            bytes: lambda: self._rng.randbytes(self._claim_room()),
            dict: dict,
            type(None): lambda: None,
        }
        if type_ not in made:
            raise UsageError(_cannot(where, type_))
        return made[type_]()

    def _several(self, kind: type, arguments: tuple[Any, ...], where: str) -> Any:  # noqa: ANN401, of `kind`
        if kind is tuple and arguments and arguments[-1] is not Ellipsis:
            return tuple(self.value(argument, where) for argument in arguments)
        if not arguments or arguments[0] not in (float, int):
            return kind()
        each = 9 if arguments[0] is float else 1  # as msgpack writes them [bytes]
        count = self._claim_room() // each
        return kind(self.value(arguments[0], where) for _ in range(count))

    def _array(self, arguments: tuple[Any, ...], where: str) -> Any:  # noqa: ANN401, an array
        import numpy as np  # noqa: PLC0415, only a robot with arrays needs it

        scalar = (get_args(arguments[-1]) or (object,))[0]
        if not (isinstance(scalar, type) and issubclass(scalar, np.generic)):
            raise UsageError(_cannot(where, "an array of any type"))
        dtype = np.dtype(scalar)
        data = self._rng.randbytes(
            self._claim_room() // dtype.itemsize * dtype.itemsize
        )
        if dtype.kind == "f":
            # any bits would be a number, but few of them a finite one
            whole = np.frombuffer(data, np.uint8)[:: dtype.itemsize]
            return (whole / np.uint8(255)).astype(dtype)
        return np.frombuffer(data, dtype)

    def _claim_room(self) -> int:
        room, self._room = self._room, 0
        return room


def _cannot(where: str, hint: object) -> str:
    return (
        f"nothing can be generated for {where} ({hint}): name a function of your own "
        "as `message`"
    )


TICK = 0.005
"""Messages go out at multiples of this [s]."""
PAUSE = 0.1
"""Between two rounds of a recording [s]."""
Due = tuple[float, Callable[[], None]]
"""When something is to be sent, since the beginning [s], and what sends it."""


class PlayedPort(Struct, frozen=True, kw_only=True):
    """What one port of the player sends: sources of the recording, or generated."""

    type: str  # the message's or interface's, as ``package.module:Class``
    calls: bool = False
    sources: tuple[str, ...] = ()
    generated: Generated | None = None


class Replay(Component):
    """Publishes and calls as its ``ports`` say, from the file ``recording``."""

    @classmethod
    def __poise_specialised__(
        cls, parameters: Mapping[str, Any], folder: str
    ) -> type[Component]:
        """Return a class that publishes and calls what `parameters` say."""
        parts = parts_of(parameters)
        types = {name: find_type(port.type, folder) for name, port in parts.items()}
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
        inputs = inputs_of(Path(recording)) if recording else []
        self._streams = [
            self._generated(name, part.generated)
            if part.generated
            else self._recorded(name, part, inputs)
            for name, part in parts_of(self.parameters).items()
        ]

    def activate(self) -> None:
        """Begin with what comes first."""
        self._began = self.clock.now()
        self._due = heapq.merge(*self._streams, key=lambda due: due[0])
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
        entries = [entry for entry in inputs if entry.source in part.sources]
        send = self._call if part.calls else self._publish_recorded
        length = max((entry.at for entry in inputs), default=0.0) + PAUSE
        for number, entry in enumerate(cycle(entries)):
            at = number // len(entries) * length + entry.at
            yield at, partial(send, name, entry)

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
        rng = random.Random(how.seed)  # noqa: S311, it is to be repeatable
        make: Any = (
            find_function(how.message, self.folder)
            if how.message
            else maker(self.types[name])
        )
        at = 0.0
        while True:
            is_poisson = how.arrivals == "poisson"
            at += rng.expovariate(how.rate) if is_poisson else 1 / how.rate
            spread = rng.uniform(-how.variation, how.variation)
            message = make(rng, how.size * (1 + spread))
            yield at, partial(self._publish, name, message)


def parts_of(parameters: Mapping[str, Any]) -> dict[str, PlayedPort]:
    """Return what a player's parameters say of its ports."""
    return convert(parameters["ports"], dict[str, PlayedPort])
