"""Values to bytes and back: msgpack with declared types, arrays as raw buffers.

In the body an array is an extension with its dtype, its shape and its offset in the
buffers laid end to end, each padded to `ALIGNMENT` bytes; nothing copies it. Nothing is
executed: no pickle, no object arrays, and the declared type decides what is accepted.
"""

from __future__ import annotations

import base64
import re
import threading
from collections.abc import Iterable
from functools import cache, lru_cache
from itertools import chain
from math import prod
from types import ModuleType
from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
    NamedTuple,
    TypeVar,
    get_args,
    get_origin,
)

import msgspec

from poise.decoding import convert, msgpack_decoder
from poise.errors import PoiseError, said

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")
Bytes = bytes | bytearray | memoryview

ALIGNMENT = 16
_NOTHING = memoryview(b"")
_ARRAY = 1
_LONGEST_HEADER = 1 << 10
"""What stands for an array is shorter, with as many sides as NumPy has [bytes]."""
_DTYPE = re.compile(r"[<>|](?!f12|f16|c24|c32)[biufcSUmM]\d{1,9}(\[\d*\w{1,2}\])?")
"""What arrays may hold, in NumPy's letters: no objects, no records, no `longdouble`,
whose bytes are other numbers on another processor."""
_NUMBERS = "biufc"
"""Letters of NumPy's kinds of numbers: each holds what those before it hold."""
_UNFIT = (TypeError, ValueError, OverflowError, RecursionError)
"""What reading or writing a value raises that is too large, too deep or malformed."""
MALFORMED = (msgspec.DecodeError, *_UNFIT)
"""What msgspec raises of bytes that are not what is wanted: not only its own errors."""


class WireError(PoiseError):
    """Bytes from a wire are not what the receiver declared; they were refused."""


class Unreadable(WireError):
    """Where they end is not known, so nothing behind them can be read."""


class _Here(threading.local):
    """The memory of the arrays in what this thread encodes, and decodes."""

    sent: list[memoryview]
    received: memoryview

    def __init__(self) -> None:
        self.sent, self.received = [], _NOTHING


_here = _Here()


class Codec(Generic[T]):
    """Encodes and decodes values of one type."""

    def __init__(self, type_: Any, name: str = "") -> None:  # noqa: ANN401, any type
        self.type = type_
        self.name = name or f"{getattr(type_, '__qualname__', type_)}"
        self._has_arrays = self._find_arrays()
        hook = _encode_array if self._has_arrays else _plain
        self._encode = msgspec.msgpack.Encoder(enc_hook=hook).encode
        self._decode = msgpack_decoder(
            type_, ext_hook=_decode_array, dec_hook=_check
        ).decode

    def _find_arrays(self) -> bool:
        """Return whether values may hold arrays; raise when none could be encoded."""
        parts = [*_parts(msgspec.inspect.type_info(self.type), set())]
        held = {p.cls for p in parts if isinstance(p, msgspec.inspect.CustomType)}
        for type_ in held - {object}:
            if not issubclass(type_, _numpy().ndarray):
                raise WireError(f"{self.name}: {_cannot_cross(type_)}")
        return bool(held) or any(isinstance(p, msgspec.inspect.AnyType) for p in parts)

    def encode(self, value: T) -> tuple[bytes, list[memoryview]]:
        """Return the body and the buffers of `value`."""
        try:
            if not self._has_arrays:
                return self._encode(value), []
            before, _here.sent = _here.sent, []
            buffers = _here.sent
            try:
                return self._encode(value), buffers
            finally:
                _here.sent = before
        except _UNFIT as error:
            raise WireError(f"{self.name} cannot cross a connector: {error}") from None

    def size_of(self, value: T) -> int:
        """Return the size of `value` when encoded [bytes]; raises as `encode`."""
        body, buffers = self.encode(value)
        return len(body) + sum(buffer.nbytes for buffer in buffers)

    def decode(self, body: Bytes, buffers: memoryview) -> T:
        """Return the value; its arrays are read-only views on `buffers`."""
        try:
            if not self._has_arrays:
                return self._decode(body)  # type: ignore[no-any-return]
            before = _here.received
            _here.received = buffers.toreadonly()  # and so are the arrays
            try:
                return self._decode(body)  # type: ignore[no-any-return]
            finally:
                _here.received = before
        # a check in a user's `__post_init__` may raise anything
        except Exception as error:
            raise WireError(f"not {self.name}: {why_not(error)}") from error


class Packed(msgspec.Struct, frozen=True):
    """A value as plain data and arrays, for who does not know its type."""

    body: bytes
    buffers: bytes = b""

    @property
    def size(self) -> int:
        """How much it is [bytes]."""
        return len(self.body) + len(self.buffers)


def pack(value: object) -> Packed:
    """Return a value as plain data; WireError when it cannot cross a connector."""
    body, buffers = codec(Any).encode(value)
    parts = ((buffer, bytes(padding(buffer.nbytes))) for buffer in buffers)
    return Packed(body, b"".join(chain.from_iterable(parts)))


def unpack(packed: Packed, type_: Any = Any) -> Any:  # noqa: ANN401, any type
    """Return what was packed, as a value of a type.

    Lists stand for arrays, too. WireError when it is no such value.
    """
    plain = codec(Any).decode(packed.body, memoryview(packed.buffers))
    try:
        return convert(plain, type_, dec_hook=_array_of)
    except Exception as error:  # such a check may raise anything
        raise WireError(why_not(error)) from error


def why_not(error: Exception) -> str:
    """Return why a value is none of its type, in words."""
    if isinstance(error, MALFORMED):
        return str(error)
    return f"{type(error).__qualname__}: {said(error)}"


def _array_of(type_: Any, value: Any) -> Any:  # noqa: ANN401, msgspec's hook
    if isinstance(value, dict) and value.keys() == {"dtype", "shape", "data"}:
        value = _recorded_array(value)
    if type_ is not object and isinstance(value, list | int | float | bool):
        wanted = (w for w in _declared(type_) if not w.__subclasses__())
        value = _array_from_list(value, next(wanted, None))
    return _check(type_, value)


def _array_from_list(value: object, wanted: type | None = None) -> np.ndarray:
    """Return an array of plain data; ValueError when numbers would become others."""
    as_array = _numpy().asarray
    array: np.ndarray = as_array(value, wanted)
    given, held = as_array(value).dtype, _NUMBERS.find(array.dtype.kind)
    if array.size and held >= 0 and given.kind not in f"{_NUMBERS[: held + 1]}O":
        raise ValueError(f"values of {given} are no array of {array.dtype}")
    return array


def _recorded_array(value: dict[str, Any]) -> np.ndarray:
    """Return an array that a recording has as text in base64."""
    dtype = _dtype(str(value["dtype"]))
    if dtype is None:
        raise ValueError(f"refused array of {value['dtype']}")
    data = base64.b64decode(value["data"], validate=True)
    array: np.ndarray = _numpy().frombuffer(data, dtype).reshape(value["shape"])
    return array


@cache
def codec(type_: Any, name: str = "") -> Codec[Any]:  # noqa: ANN401, any type
    """Return the codec of a type; the same one every time."""
    return Codec(type_, name)


def padding(length: int) -> int:
    """Return how many bytes [B] bring `length` to a multiple of `ALIGNMENT`."""
    return -length % ALIGNMENT


def _plain(value: Any) -> Any:  # noqa: ANN401, msgspec's hook
    """Return a number of NumPy's as a plain one; refuse all else."""
    if type(value).__module__ == "numpy" and not getattr(value, "shape", "none"):
        return value.item()
    raise WireError(_cannot_cross(type(value)))


def _cannot_cross(type_: type) -> str:
    return (
        f"a value of type {type_.__qualname__} cannot cross a connector; use a "
        "Message, plain data or a NumPy array, where the type of the port or state "
        "says so"
    )


@cache
def _numpy() -> ModuleType:
    """Return NumPy; an import statement costs more than all else with a small array."""
    import numpy as np  # noqa: PLC0415, see above

    return np


def _encode_array(value: Any) -> Any:  # noqa: ANN401, whatever msgspec does not know
    np = _numpy()
    if not isinstance(value, np.ndarray):
        return _plain(value)
    if type(value) is not np.ndarray and isinstance(value, np.ma.MaskedArray):
        raise WireError(
            "a masked array cannot cross a connector, for its mask would be lost; use "
            "a Message with an array of data and one of the mask"
        )
    buffers = _here.sent
    offset = sum(b.nbytes + padding(b.nbytes) for b in buffers) if buffers else 0
    extension = _extension(value.dtype, value.shape, offset)
    try:
        memory = memoryview(value).cast("B")
    except (TypeError, ValueError):  # not of one piece, empty, or of times
        memory = np.ascontiguousarray(value).reshape(-1).view(np.uint8).data
    buffers.append(memory)
    return extension


@lru_cache(maxsize=256)
def _extension(dtype: np.dtype[Any], shape: tuple[int, ...], offset: int) -> Any:  # noqa: ANN401, msgspec's own
    """Return what stands for an array in a body."""
    if _dtype(dtype.str) is None:
        raise WireError(
            f"an array of {dtype} cannot cross a connector; use one of numbers, but "
            "not of longdouble, or a Message with one for each field"
        )
    header = msgspec.msgpack.encode((dtype.str, shape, offset))
    return msgspec.msgpack.Ext(_ARRAY, header)


def _dtype(name: str) -> np.dtype[Any] | None:
    """Return what arrays of a type hold, by its name; None when it may not cross."""
    return _numpy().dtype(name) if _DTYPE.fullmatch(name) else None


class _Layout(NamedTuple):
    """How an array lies in the buffers; `offset` and `end` in [bytes]."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    offset: int
    end: int


_array_header = msgpack_decoder(tuple[str, tuple[int, ...], int]).decode


@lru_cache(maxsize=256)
def _layout(header: bytes) -> _Layout:
    """Return what a header says; the same arrays come again and again."""
    name, shape, offset = _array_header(header)
    dtype = _dtype(name)
    if dtype is None or not dtype.itemsize or min((0, *shape)) < 0 or offset < 0:
        raise ValueError(f"refused array {name} {shape} at {offset}")
    return _Layout(shape, dtype, offset, offset + prod(shape) * dtype.itemsize)


def _decode_array(code: int, data: memoryview) -> np.ndarray:
    if code != _ARRAY or len(data) > _LONGEST_HEADER:
        raise ValueError(f"refused extension {code} of {len(data)} B")
    shape, dtype, offset, end = _layout(bytes(data))
    buffers = _here.received
    if end > buffers.nbytes:
        raise ValueError(f"array of {end - offset} B at {offset} in {buffers.nbytes} B")
    array: np.ndarray = _numpy().ndarray(shape, dtype, buffers, offset)
    return array


def _check(type_: Any, value: Any) -> Any:  # noqa: ANN401, msgspec's hook
    """Refuse an array whose dtype is not the one that ``NDArray[...]`` declares."""
    if type_ is object:  # which is `Any`, but not for msgspec
        return value
    if not isinstance(value, _numpy().ndarray):
        raise TypeError(f"a {type(value).__qualname__}, not an array")
    for wanted in _declared(type_):
        if not issubclass(value.dtype.type, wanted):
            raise TypeError(f"array of {value.dtype}, not {wanted.__name__}")
    return value


def without_alias(type_: Any) -> Any:  # noqa: ANN401, any type
    """Return what a type alias stands for, such as `NDArray` since NumPy 2.5."""
    alias = get_origin(type_) or type_
    if type(alias).__name__ != "TypeAliasType":
        return type_
    value, given = alias.__value__, get_args(type_)
    if given and (taken := getattr(value, "__parameters__", ())):
        by_parameter = dict(zip(alias.__type_params__, given, strict=True))
        value = value[tuple(by_parameter[each] for each in taken)]
    return without_alias(value)


@cache
def _declared(type_: Any) -> tuple[type, ...]:  # noqa: ANN401, any type
    """Return what ``NDArray[...]`` declares its arrays to hold; () when anything."""
    import numpy as np  # noqa: PLC0415, only where users' arrays are

    held = [wanted for part in get_args(type_) for wanted in get_args(part)]
    return tuple(w for w in held if isinstance(w, type) and issubclass(w, np.generic))


def _parts(info: Any, seen: set[int]) -> Iterable[Any]:  # noqa: ANN401, msgspec.inspect
    """Yield a type's description and those of all types inside it."""
    if isinstance(info, tuple):
        for item in info:
            yield from _parts(item, seen)
    elif isinstance(info, msgspec.inspect.Type | msgspec.inspect.Field):
        if id(info) in seen:
            return
        seen.add(id(info))
        yield info
        for name in info.__struct_fields__:
            yield from _parts(getattr(info, name), seen)
