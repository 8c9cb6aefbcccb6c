"""Generates messages: of a type, of a size, the same for the same seed."""

from __future__ import annotations

import enum
import random
import types
from collections.abc import Callable
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from poise.errors import UsageError
from poise.wire.codec import codec

Maker = Callable[[random.Random, float], Any]
"""Makes a message of about this encoded size [bytes]."""

_TRIES = 3
_HALF = 0.5
_SMALL = 100
"""Integers are smaller, so that all take one byte."""


def maker(type_: Any) -> Maker:  # noqa: ANN401, any type of a message
    """Return what makes messages of `type_`.

    Numbers are random. One field that can be of any length, a text, bytes, an array or
    a list, the first that there is, is as long as the size asks for; all others are
    empty. A message without such a field has the size that it has.

    Raises
    ------
    UsageError
        A field is of a type for which nothing can be generated.
    """
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

    make(random.Random(0), 0.0)  # noqa: S311, to see whether it can be made at all
    return make


class _Filling:
    """Makes one message; the first field of any length gets `room` [bytes]."""

    def __init__(self, rng: random.Random, room: int) -> None:
        self._rng = rng
        self._room = room

    def value(self, hint: Any, where: str) -> Any:  # noqa: ANN401, PLR0911, any type
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
                *(self.value(hints[f.name], f"{where}.{f.name}") for f in fields)
            )
        return self._plain(plain, where)

    def _plain(self, type_: type, where: str) -> Any:  # noqa: ANN401, of `type_`
        if issubclass(type_, enum.Enum):
            return next(iter(type_))
        made: dict[type, Callable[[], Any]] = {
            bool: lambda: self._rng.random() < _HALF,
            int: lambda: self._rng.randrange(_SMALL),
            float: self._rng.random,
            str: lambda: "a" * self._take(),
            bytes: lambda: self._rng.randbytes(self._take()),
            dict: dict,
            type(None): lambda: None,
        }
        if type_ not in made:
            raise UsageError(_cannot(where, type_))
        return made[type_]()

    def _several(self, kind: type, arguments: tuple[Any, ...], where: str) -> Any:  # noqa: ANN401, of `kind`
        if kind is tuple and arguments and arguments[-1] is not Ellipsis:
            return tuple(self.value(each, where) for each in arguments)
        if not arguments or arguments[0] not in (float, int):
            return kind()
        each = 9 if arguments[0] is float else 1  # as msgpack writes them [bytes]
        count = self._take() // each
        return kind(self.value(arguments[0], where) for _ in range(count))

    def _array(self, arguments: tuple[Any, ...], where: str) -> Any:  # noqa: ANN401, an array
        import numpy as np  # noqa: PLC0415, only a robot with arrays needs it

        scalar = (get_args(arguments[-1]) or (object,))[0]
        if not (isinstance(scalar, type) and issubclass(scalar, np.generic)):
            raise UsageError(_cannot(where, "an array of any type"))
        dtype = np.dtype(scalar)
        data = self._rng.randbytes(self._take() // dtype.itemsize * dtype.itemsize)
        if dtype.kind == "f":
            # any bits would be a number, but few of them a finite one
            whole = np.frombuffer(data, np.uint8)[:: dtype.itemsize]
            return (whole / np.uint8(255)).astype(dtype)
        return np.frombuffer(data, dtype)

    def _take(self) -> int:
        room, self._room = self._room, 0
        return room


def _cannot(where: str, hint: object) -> str:
    return (
        f"nothing can be generated for {where} ({hint}): name a function of your own "
        "as `message`"
    )
