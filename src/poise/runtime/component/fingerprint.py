"""Whether two types mean the same to the wire, although they are not one object."""

from __future__ import annotations

import inspect
from collections.abc import Hashable
from typing import Any, get_args, get_origin, get_type_hints

from msgspec import Struct

from poise.runtime.component.ports import is_oneway, methods_of

Seen = tuple[type, ...]


def fingerprint(type_: Any) -> Hashable:  # noqa: ANN401, any type
    """Return what a message or interface type is made of, by name and by structure.

    Two types with equal fingerprints fit each other: messages with the same fields,
    interfaces whose methods take and return the same. The modules do not count, so a
    class that was imported under two names fits itself.
    """
    return _fingerprint(type_, ())


def _fingerprint(type_: Any, seen: Seen) -> Hashable:  # noqa: ANN401, any type
    if get_origin(type_) is not None:
        inner = tuple(_fingerprint(arg, seen) for arg in get_args(type_))
        return (str(get_origin(type_)), inner)
    if not isinstance(type_, type) or type_ in seen:
        return getattr(type_, "__qualname__", repr(type_))
    if issubclass(type_, Struct):
        return (type_.__qualname__, _fields(type_, (*seen, type_)))
    if type_.__module__ == "builtins" or not methods_of(type_):
        return type_.__qualname__
    return (type_.__qualname__, _methods(type_, (*seen, type_)))


def _fields(message: type[Struct], seen: Seen) -> Hashable:
    hints = get_type_hints(message, include_extras=True)
    return tuple(
        (name, _fingerprint(hints[name], seen)) for name in message.__struct_fields__
    )


def _methods(interface: type, seen: Seen) -> Hashable:
    described = []
    for name in methods_of(interface):
        method = getattr(interface, name)
        hints = get_type_hints(method)
        takes = tuple(
            (parameter, _fingerprint(hints.get(parameter), seen))
            for parameter in list(inspect.signature(method).parameters)[1:]
        )
        gives = _fingerprint(hints.get("return"), seen)
        described.append((name, takes, gives, is_oneway(interface, name)))
    return tuple(sorted(described, key=lambda entry: entry[0]))
