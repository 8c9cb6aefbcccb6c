"""Messages of ROS 2 from and to those of Poise, field by field, by their names.

A field that a message with a `header` lacks is looked for there: so `stamp: Stamp` and
`frame_id: str` fit. Numbers in an array are copied at most once, and all together.
"""

from __future__ import annotations

import array
import enum
import importlib
import re
import struct
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import msgspec

from poise.clock import ComponentClock, Stamp, wall_time
from poise.errors import RobotError, did_you_mean, listed
from poise.wire.codec import without_alias

_CODES = {
    "float": "f",
    "double": "d",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "char": "B",
}
"""The numbers of ROS 2, as `array` and NumPy call them."""
_PLAIN = {"boolean": bool, "string": str, "wstring": str, "octet": bytes}
_NANO = 1_000_000_000

Convert = Callable[[Any], Any]


class Conversion(NamedTuple):
    """How a value goes to ROS 2, and how it comes from there."""

    to_ros: Convert
    from_ros: Convert


class Conversions:
    """Makes conversions, and gathers why some cannot be made."""

    def __init__(self, clock: ComponentClock) -> None:
        self._clock = clock
        self._problems: list[str] = []

    def of(self, message: type[Any], ros: Any) -> Conversion:  # noqa: ANN401, a generated class
        """Return the conversion of a message, or RobotError with all that misfits."""
        self._problems = []
        pair = self._message(message, ros, message.__qualname__)
        if self._problems:
            raise RobotError("; ".join(self._problems))
        return pair

    def _wrong(self, where: str, text: str) -> Conversion:
        self._problems.append(f"{where}: {text}")
        return _SAME

    def _message(self, message: type[Any], ros: Any, where: str) -> Conversion:  # noqa: ANN401
        kinds = ros.get_fields_and_field_types()
        header = _class_of(kinds["header"]) if "header" in kinds else None
        inner = header.get_fields_and_field_types() if header else {}
        steps = []
        for name, hint in _hints(message).items():
            at = f"{where}.{name}"
            if name in kinds:
                steps.append((name, False, self._value(hint, kinds[name], at)))
            elif name in inner:
                steps.append((name, True, self._value(hint, inner[name], at)))
            else:
                known = [*kinds, *inner]
                kind = f"{ros.__module__.split('.')[0]}/{ros.__name__}"
                text = f"{kind} has no such field{did_you_mean(name, known)}"
                self._wrong(at, f"{text}; it has {listed(known)}")

        def to_ros(value: Any) -> Any:  # noqa: ANN401, a message
            made = ros()
            for name, is_inner, pair in steps:
                holder = made.header if is_inner else made
                setattr(holder, name, pair.to_ros(getattr(value, name)))
            return made

        def from_ros(value: Any) -> Any:  # noqa: ANN401, a message
            return message(
                **{
                    name: pair.from_ros(
                        getattr(value.header if is_inner else value, name)
                    )
                    for name, is_inner, pair in steps
                }
            )

        return Conversion(to_ros, from_ros)

    def _value(self, hint: Any, kind: str, where: str) -> Conversion:  # noqa: ANN401, a type
        hint = without_alias(hint)
        if hint is Stamp or kind == "builtin_interfaces/Time":
            return self._time(hint, kind, where)
        if kind == "builtin_interfaces/Duration":
            return self._duration(hint, where)
        if (of := _element(kind)) is not None:
            pair = self._several(hint, of, kind, where)
            return Conversion(_sized(pair.to_ros, kind, where), pair.from_ros)
        if "/" in kind:
            if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
                return self._message(hint, _class_of(kind), where)
            return self._wrong(where, f"is {_shown(hint)}, but a {kind} in ROS 2")
        return self._single(hint, kind, where)

    def _single(self, hint: Any, kind: str, where: str) -> Conversion:  # noqa: ANN401, a type
        kind = kind.partition("<")[0]
        wanted = _PLAIN.get(kind) or (float if kind in {"float", "double"} else int)
        uncut = _uncut(kind, where) if wanted in {int, str, bytes} else wanted
        if isinstance(hint, type) and issubclass(hint, enum.Enum):
            return Conversion(lambda value: uncut(value.value), hint)
        if get_origin(hint) is Literal and type(get_args(hint)[0]) is wanted:
            return _SAME
        if hint is wanted or (hint is float and wanted is int):
            return Conversion(uncut, hint)
        return self._wrong(where, f"is {_shown(hint)}, but a {kind} in ROS 2")

    def _several(self, hint: Any, of: str, kind: str, where: str) -> Conversion:  # noqa: ANN401
        origin, arguments = get_origin(hint), get_args(hint)
        if of in _CODES and getattr(origin, "__name__", "") == "ndarray":
            return self._numbers(arguments, of, kind, where)
        if of in {"uint8", "char"} and hint is bytes:
            return Conversion(lambda value: array.array("B", value), bytes)
        if origin not in {list, tuple} or not arguments:
            return self._wrong(where, f"is {_shown(hint)}, but {kind} in ROS 2")
        each = self._value(arguments[0], of, f"{where}[]")

        def from_ros(values: Any) -> Any:  # noqa: ANN401, a sequence
            return origin(map(each.from_ros, values))

        return Conversion(lambda values: [*map(each.to_ros, values)], from_ros)

    def _numbers(self, arguments: Any, of: str, kind: str, where: str) -> Conversion:  # noqa: ANN401
        """Return the conversion of an array of numbers, which are not looked at."""
        import numpy as np  # noqa: PLC0415, only a robot with arrays needs it

        dtype = np.dtype(_CODES[of])
        scalar = (get_args(arguments[-1]) or (object,))[0]
        if not (isinstance(scalar, type) and issubclass(scalar, np.generic)):
            return self._wrong(where, f"is an array of anything, but {kind} in ROS 2")
        if np.dtype(scalar) != dtype:
            text = f"has numbers of {np.dtype(scalar)}, but {dtype} in ROS 2"
            return self._wrong(where, f"{text}: NDArray[np.{dtype}]")

        def to_sequence(value: Any) -> Any:  # noqa: ANN401, an array
            made = array.array(dtype.char)
            made.frombytes(
                np.ascontiguousarray(value, dtype).reshape(-1).data.cast("B")
            )
            return made

        def to_fixed(value: Any) -> Any:  # noqa: ANN401, an array
            return np.asarray(value, dtype).reshape(-1)

        def from_ros(value: Any) -> Any:  # noqa: ANN401, an array
            made = np.frombuffer(value, dtype)
            made.flags.writeable = False
            return made

        return Conversion(to_sequence if kind.startswith("seq") else to_fixed, from_ros)

    def _time(self, hint: Any, kind: str, where: str) -> Conversion:  # noqa: ANN401, a type
        if hint is not Stamp or kind != "builtin_interfaces/Time":
            return self._wrong(where, f"is {_shown(hint)}, but {kind} in ROS 2")
        time_of, clock = _class_of(kind), self._clock

        def to_ros(stamp: Stamp) -> Any:  # noqa: ANN401, a message
            age = clock.since(stamp)
            if age is None:  # that computer's clock is not known yet
                return time_of()
            sec, nanosec = divmod(round((wall_time() - age.value) * _NANO), _NANO)
            return time_of(sec=sec, nanosec=nanosec)

        def from_ros(time: Any) -> Stamp:  # noqa: ANN401, a message
            if not (time.sec or time.nanosec):
                return _NO_STAMP
            age = wall_time() - time.sec - time.nanosec / _NANO
            return clock.stamp(clock.now() - age)

        return Conversion(to_ros, from_ros)

    def _duration(self, hint: Any, where: str) -> Conversion:  # noqa: ANN401, a type
        if hint is not float:
            return self._wrong(where, f"is {_shown(hint)}, but a Duration: float [s]")
        duration_of = _class_of("builtin_interfaces/Duration")
        uncut = _uncut("int32", where)

        def to_ros(seconds: float) -> Any:  # noqa: ANN401, a message
            sec, nanosec = divmod(round(seconds * _NANO), _NANO)
            return duration_of(sec=uncut(sec), nanosec=nanosec)

        return Conversion(to_ros, lambda value: value.sec + value.nanosec / _NANO)


_NO_STAMP = Stamp(0.0, "?")
"""Says that there is none: nobody knows that computer's clock."""


def _uncut(kind: str, where: str) -> Convert:
    """Return what makes a value, and refuses one that ROS 2 would cut unasked."""
    of = _PLAIN.get(kind) or int
    fits = _FITS.get(kind) or _range(kind)

    def to_ros(value: Any) -> Any:  # noqa: ANN401, a number, text or byte
        if not fits(made := of(value)):
            raise ValueError(f"{where} is {made!r}, which does not fit into {kind}")
        return made

    return to_ros


_FITS: dict[str, Callable[[Any], bool]] = {
    # it would end at a NUL; half a pair cannot be sent
    "string": lambda text: not re.search("[\0\ud800-\udfff]", text),
    "wstring": lambda _: True,
    "octet": lambda byte: len(byte) == 1,
}


def _range(kind: str) -> Callable[[int], bool]:
    """Return what says whether a number fits into a kind of ROS 2's."""
    code = _CODES[kind]
    bits = 8 * struct.calcsize(f"={code}")
    low, high = (-(1 << bits - 1), 1 << bits - 1) if code.islower() else (0, 1 << bits)
    return lambda number: low <= number < high


def _sized(to_ros: Convert, kind: str, where: str) -> Convert:
    """Return what checks a length, too, beyond which ROS 2 would read other memory."""
    size = re.search(r"(\[|, ?)(\d+)[]>]$", kind)
    if size is None:
        return to_ros
    is_fixed, most = size[1] == "[", int(size[2])

    def sized(value: Any) -> Any:  # noqa: ANN401, a sequence
        made = to_ros(value)
        if len(made) > most or (is_fixed and len(made) < most):
            raise ValueError(f"{where} has {len(made)} values, but is {kind} in ROS 2")
        return made

    return sized


def _same(value: Any) -> Any:  # noqa: ANN401, any value
    return value


_SAME = Conversion(_same, _same)


def _hints(message: type[Any]) -> dict[str, Any]:
    hints = get_type_hints(message)
    return {name: hints[name] for name in message.__struct_fields__}


def _element(kind: str) -> str | None:
    """Return what ``sequence<double>`` or ``double[9]`` has; None: it is neither."""
    if kind.startswith("sequence<"):
        return kind.removeprefix("sequence<")[:-1].partition(",")[0]
    return kind[: kind.rindex("[")] if kind.endswith("]") else None


def _class_of(kind: str) -> Any:  # noqa: ANN401, a generated class
    package, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _shown(hint: Any) -> str:  # noqa: ANN401, any type
    return getattr(hint, "__qualname__", None) or str(hint)
