"""Checks a tree of nodes against the types of `poise.model.sections`.

The validator knows msgspec's types and nothing of robots. It finds every problem in one
pass.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias, cast

from msgspec import Struct
from msgspec import inspect as types

from poise.errors import Problem
from poise.model.suggest import did_you_mean, listed
from poise.model.yaml.plain import plain_value
from poise.model.yaml.tree import Location, Node, Scalar
from poise.units import DIMENSIONS, NUMBER, parse, quoted

Value: TypeAlias = Any
"""A plain value of the right type, or `_INVALID`."""
_INVALID: Any = object()
"""Stands for a value that has a problem."""


class Where(Struct, frozen=True):
    """The value under validation.

    Parameters
    ----------
    name
        Its keys from the top, with dots.
    extra
        Notes that `sections` attaches to its type.
    """

    name: str
    place: Location
    problems: list[Problem]
    extra: Mapping[str, Any] = {}

    def inner(self, key: str | int, node: Node) -> Where:
        """Return an entry of this mapping or list."""
        step = f"[{key}]" if isinstance(key, int) else f".{quoted(key)[1:-1]}"
        name = f"{self.name}{step}".removeprefix(".")
        return Where(name, node.place, self.problems)

    def noted(self, extra: Mapping[str, Any]) -> Where:
        """Return a copy with further notes."""
        return Where(self.name, self.place, self.problems, {**self.extra, **extra})

    def wrong(self, text: str) -> Value:
        """Add a problem that names the key; return no value."""
        message = f"{self.name}: {text}" if self.name else text
        self.problems.append(self.place.problem(message))
        return _INVALID


def validate(node: Node, kind: types.Type, problems: list[Problem]) -> Value:
    """Return the plain SI value of `node`, whose type is `kind`.

    Every problem is added to `problems`. A wrong single value of an optional key is
    dropped, so that later checks find further problems. None is returned when
    something wrong cannot be dropped.
    """
    value = _value(node, kind, Where("", node.place, problems))
    return None if value is _INVALID else value


def _value(node: Node, kind: types.Type, where: Where) -> Value:
    if isinstance(kind, types.Metadata):
        return _value(node, kind.type, where.noted(kind.extra or {}))
    return _READERS[type(kind)](node, kind, where)


def _struct(node: Node, kind: types.StructType, where: Where) -> Value:
    fields = {field.encode_name: field for field in kind.fields}
    if not isinstance(node.value, dict):
        return where.wrong(
            f"must be a mapping with {listed(fields)}, not {_kind(node)}"
        )
    _refuse_unknown(node.value, kind, where)
    values = {}
    for key, field in fields.items():
        if key in node.value:
            entry = node.value[key]
            values[key] = _value(entry, field.type, where.inner(key, entry))
        elif field.required:
            thing = _noun(kind)
            values[key] = where.wrong(f"the {thing} lacks the key '{key}'")
    wrong = [key for key, value in values.items() if value is _INVALID]
    if any(fields[k].required or _shape(fields[k].type) != "scalar" for k in wrong):
        return _INVALID
    return {key: value for key, value in values.items() if key not in wrong}


def _refuse_unknown(
    entries: Mapping[str, Node], kind: types.StructType, where: Where
) -> None:
    thing = _noun(kind)
    known = [field.encode_name for field in kind.fields]
    for key in entries:
        if key not in known:
            where.inner(key, entries[key]).wrong(
                f"the {thing} has the unknown key {quoted(key)}"
                f"{did_you_mean(key, known)}; keys: {listed(known)}"
            )


def _noun(kind: types.StructType) -> str:
    return kind.cls.__name__.removesuffix("Section").lower()


def _dict(node: Node, kind: types.DictType, where: Where) -> Value:
    if not isinstance(node.value, dict):
        return where.wrong(f"must be a mapping, as in {{a: ...}}, not {_kind(node)}")
    right = _has_length(len(node.value), kind, where)
    values = {}
    for key, entry in node.value.items():
        inner = where.inner(key, entry)
        named = Node(entry.place, Scalar(key, plain=False))
        right &= _value(named, kind.key_type, inner) is not _INVALID
        values[key] = _value(entry, kind.value_type, inner)
    return values if right and _INVALID not in values.values() else _INVALID


def _list(node: Node, kind: types.ListType, where: Where) -> Value:
    if not isinstance(node.value, list):
        return where.wrong(f"must be a list, as in [a, b], not {_kind(node)}")
    right = _has_length(len(node.value), kind, where)
    values = [
        _value(item, kind.item_type, where.inner(i, item))
        for i, item in enumerate(node.value)
    ]
    return values if right and _INVALID not in values else _INVALID


def _tuple(node: Node, kind: types.TupleType, where: Where) -> Value:
    wanted = len(kind.item_types)
    if not isinstance(node.value, list) or len(node.value) != wanted:
        return where.wrong(
            f"must be a list of {wanted}, as in [a, b], not {_kind(node)}"
        )
    pairs = zip(node.value, kind.item_types, strict=True)
    values = [
        _value(item, item_kind, where.inner(i, item))
        for i, (item, item_kind) in enumerate(pairs)
    ]
    return _INVALID if _INVALID in values else values


def _union(node: Node, kind: types.UnionType, where: Where) -> Value:
    """Choose the member by the shape of the node: no two members share one."""
    members = {_shape(member): member for member in kind.types}
    if "null" in members and _is_null(node):
        return None
    shape = _node_shape(node)
    if shape not in members:
        shape = next(iter(members))
    return _value(node, members[shape], where)


def _text(node: Node, kind: types.StrType, where: Where) -> Value:
    text = _scalar(node, where)
    if text is None:
        return _INVALID
    if len(text) < (kind.min_length or 0):
        return where.wrong("is empty")
    if kind.pattern is not None and not re.fullmatch(kind.pattern, text):
        wanted = where.extra.get("expected", kind.pattern)
        return where.wrong(f"{quoted(text)} is not allowed; write {wanted}")
    try:
        where.extra.get("parse", str)(text)
    except ValueError as error:
        return where.wrong(str(error))
    return text


def _number(node: Node, kind: types.FloatType, where: Where) -> Value:
    text = _scalar(node, where)
    if text is None:
        return _INVALID
    dimension = DIMENSIONS[where.extra.get("dimension", NUMBER.name)]
    try:
        value = parse(text, dimension)
    except ValueError as error:
        return where.wrong(str(error))
    return _in_range(value, text, kind, where)


def _integer(node: Node, kind: types.IntType, where: Where) -> Value:
    text = _scalar(node, where)
    if text is None:
        return _INVALID
    if not re.fullmatch(r"[+-]?[0-9]{1,15}", text):
        return where.wrong(f"{quoted(text)} is not a whole number")
    return _in_range(int(text), text, kind, where)


def _truth(node: Node, _kind: types.BoolType, where: Where) -> Value:
    text = _scalar(node, where)
    if text is None or text in ("true", "false"):
        return _INVALID if text is None else text == "true"
    return where.wrong(f"{quoted(text)} is neither 'true' nor 'false'")


def _choice(node: Node, kind: types.LiteralType, where: Where) -> Value:
    text = _scalar(node, where)
    choices = [str(value) for value in kind.values]
    if text is None or text in choices:
        return _INVALID if text is None else text
    return where.wrong(
        f"{quoted(text)} is not one of {listed(choices)}{did_you_mean(text, choices)}"
    )


def _anything(node: Node, _kind: types.AnyType, where: Where) -> Value:
    try:
        return plain_value(node)
    except ValueError as error:
        return where.wrong(str(error))


def _scalar(node: Node, where: Where) -> str | None:
    """Return the text of a single value, or add a problem and return None."""
    if isinstance(node.value, Scalar) and (node.value.text or not node.value.plain):
        return node.value.text
    where.wrong(f"must be a single value, not {_kind(node)}")
    return None


def _has_length(
    length: int, kind: types.DictType | types.ListType, where: Where
) -> bool:
    least, most = kind.min_length or 0, kind.max_length
    if least <= length and (most is None or length <= most):
        return True
    wanted = f"at least {least}" if length < least else f"at most {most}"
    where.wrong(f"has {length} entries; it takes {wanted}")
    return False


_LIMITS: Mapping[str, tuple[str, Callable[[float, float], bool]]] = {
    "gt": ("above", lambda value, limit: value > limit),
    "ge": ("at least", lambda value, limit: value >= limit),
    "lt": ("below", lambda value, limit: value < limit),
    "le": ("at most", lambda value, limit: value <= limit),
}


def _in_range(
    value: float, text: str, kind: types.FloatType | types.IntType, where: Where
) -> Value:
    for name, (words, holds) in _LIMITS.items():
        limit = getattr(kind, name)
        if limit is not None and not holds(value, limit):
            return where.wrong(f"{quoted(text)} must be {words} {limit}")
    return value


def _kind(node: Node) -> str:
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, list):
        return f"a list of {len(node.value)}"
    return quoted(node.value.text) if node.value.text else "nothing"


def _is_null(node: Node) -> bool:
    return (
        isinstance(node.value, Scalar)
        and node.value.plain
        and node.value.text in ("", "~", "null")
    )


def _node_shape(node: Node) -> str:
    if isinstance(node.value, dict):
        return "mapping"
    return "list" if isinstance(node.value, list) else "scalar"


def _shape(kind: types.Type) -> str:
    if isinstance(kind, types.Metadata):
        return _shape(kind.type)
    shapes: dict[type, str] = {
        types.StructType: "mapping",
        types.DictType: "mapping",
        types.ListType: "list",
        types.TupleType: "list",
        types.NoneType: "null",
    }
    return shapes.get(type(kind), "scalar")


_Reader = Callable[[Node, Any, Where], Value]
_READERS = cast(
    "Mapping[type, _Reader]",
    {
        types.StructType: _struct,
        types.DictType: _dict,
        types.ListType: _list,
        types.TupleType: _tuple,
        types.UnionType: _union,
        types.StrType: _text,
        types.FloatType: _number,
        types.IntType: _integer,
        types.BoolType: _truth,
        types.LiteralType: _choice,
        types.AnyType: _anything,
    },
)
