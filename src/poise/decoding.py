"""Makes and uses msgspec's decoders, one thread at a time.

msgspec (0.22) keeps on each class what its decoders know of it before it is whole: one
that another thread makes meanwhile would crash the process as it decodes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any, TypeVar, overload

import msgspec

T = TypeVar("T")
Bytes = bytes | bytearray | memoryview
Hook = Callable[[Any, Any], Any]
ExtHook = Callable[[int, memoryview], Any]

_making = threading.RLock()  # a hook may decode something itself
# a process that is forked meanwhile would have classes of which half is known
os.register_at_fork(
    before=_making.acquire,
    after_in_parent=_making.release,
    after_in_child=_making.release,
)


@overload
def msgpack_decoder(
    type_: type[T], *, dec_hook: Hook | None = None, ext_hook: ExtHook | None = None
) -> msgspec.msgpack.Decoder[T]: ...


@overload
def msgpack_decoder(
    type_: object, *, dec_hook: Hook | None = None, ext_hook: ExtHook | None = None
) -> msgspec.msgpack.Decoder[Any]: ...


def msgpack_decoder(
    type_: Any, *, dec_hook: Hook | None = None, ext_hook: ExtHook | None = None
) -> msgspec.msgpack.Decoder[Any]:
    """Return a decoder of MessagePack; parameters as for msgspec's."""
    with _making:
        return msgspec.msgpack.Decoder(type_, dec_hook=dec_hook, ext_hook=ext_hook)


@overload
def json_decoder(type_: type[T]) -> msgspec.json.Decoder[T]: ...


@overload
def json_decoder(type_: object) -> msgspec.json.Decoder[Any]: ...


def json_decoder(type_: Any) -> msgspec.json.Decoder[Any]:
    """Return a decoder of JSON."""
    with _making:
        return msgspec.json.Decoder(type_)


@overload
def from_msgpack(data: Bytes, type_: type[T]) -> T: ...


@overload
def from_msgpack(data: Bytes, type_: object) -> Any: ...  # noqa: ANN401, any type


def from_msgpack(data: Bytes, type_: Any) -> Any:
    """Return what is encoded as MessagePack; raises as msgspec's decoders."""
    return msgpack_decoder(type_).decode(data)


@overload
def from_json(data: bytes | str, type_: type[T]) -> T: ...


@overload
def from_json(data: bytes | str, type_: object) -> Any: ...  # noqa: ANN401, any type


def from_json(data: bytes | str, type_: Any) -> Any:
    """Return what is encoded as JSON; raises as msgspec's decoders."""
    return json_decoder(type_).decode(data)


@overload
def convert(value: object, type_: type[T], *, dec_hook: Hook | None = None) -> T: ...


@overload
def convert(value: object, type_: object, *, dec_hook: Hook | None = None) -> Any: ...  # noqa: ANN401, any type


def convert(value: object, type_: Any, *, dec_hook: Hook | None = None) -> Any:
    """Return plain data as a value of a type; raises as `msgspec.convert`.

    Keys may be texts, as JSON has them, where the type wants numbers.
    """
    with _making:
        return msgspec.convert(value, type_, dec_hook=dec_hook, str_keys=True)
