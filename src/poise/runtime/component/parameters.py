"""A component's parameters: plain values, or of the type that its class declares."""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Struct

from poise.decoding import convert
from poise.errors import UsageError, did_you_mean, listed
from poise.units import DIMENSIONS, parse
from poise.wire.codec import why_not

Values = Mapping[str, Any]
"""Parameters as the robot file has them."""


def parameters_type(implementation: type) -> type[Struct] | None:
    """Return what ``parameters: Gains`` declares; None: plain values."""
    declared = get_type_hints(implementation).get("parameters")
    is_struct = isinstance(declared, type) and issubclass(declared, Struct)
    return declared if is_struct else None


def as_declared(implementation: type, values: Values) -> Any:  # noqa: ANN401, any type
    """Return parameters of the type that a class declares; numbers may have units."""
    type_ = parameters_type(implementation)
    if type_ is None:
        return values
    if wrong := [text for _, text in problems(type_, values)]:
        raise UsageError(f"{implementation.__qualname__}: {'; '.join(wrong)}")
    return convert(_in_si(type_, values), type_)


def problems(type_: type[Struct], values: Values) -> Iterator[tuple[str, str]]:
    """Yield each parameter that does not fit, and why; an empty name: it lacks some."""
    is_fine = True
    fields = {field.encode_name: field for field in msgspec.structs.fields(type_)}
    for name in values:
        if name not in fields:
            guess = did_you_mean(name, fields)
            known = f"{type_.__qualname__} has {listed(fields)}"
            is_fine = False
            yield name, f"there is no parameter '{name}'{guess}; {known}"
    given = _in_si(type_, values)
    for name, field in fields.items():
        if name not in values:
            if field.required:
                is_fine = False
                yield "", f"parameter '{name}' is missing"
            continue
        try:
            convert(given[name], field.type)
        # a check in a `__post_init__` may raise anything
        except Exception as error:  # noqa: BLE001
            is_fine = False
            yield name, f"parameter '{name}' is {values[name]!r}: {why_not(error)}"
    if is_fine:
        try:
            convert(given, type_)
        except Exception as error:  # noqa: BLE001, such a check
            yield "", why_not(error)


def plain(parameters: Any) -> dict[str, Any]:  # noqa: ANN401, any type
    """Return parameters as plain values by name."""
    if isinstance(parameters, Struct):
        return dict(msgspec.to_builtins(parameters))
    return dict(parameters)


def _in_si(type_: type[Struct], values: Values) -> dict[str, Any]:
    """Return values whose quantities are plain numbers in SI units."""
    hints = get_type_hints(type_)
    return {
        name: _quantity(value)
        if isinstance(value, str) and _is_number(hints.get(name))
        else value
        for name, value in values.items()
    }


def _is_number(hint: Any) -> bool:  # noqa: ANN401, any type
    if get_origin(hint) in {Union, types.UnionType}:
        return str not in get_args(hint) and any(map(_is_number, get_args(hint)))
    return hint in {float, int}


def _quantity(text: str) -> float | int | str:
    """Return a quantity in SI; a text that is none as it is."""
    for dimension in DIMENSIONS.values():
        with suppress(ValueError):
            number = parse(text, dimension)
            return int(number) if number.is_integer() else number
    return text
