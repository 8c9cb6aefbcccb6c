"""Checks a tree of nodes against the keys of records (`poise.model.file_keys`).

The validator knows nothing of robots. It finds every problem in one pass.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from msgspec import Struct
from msgspec import inspect as types

from poise.errors import FileProblem, did_you_mean, listed
from poise.model.file_keys import FileKey, form_of, keys_in
from poise.model.yaml_tree import Location, Node, Scalar
from poise.units import SECONDS, parse, quoted

NULLS = ("", "~", "null")
_WORDS = dict.fromkeys(NULLS) | {"true": True, "false": False}
_INTEGER = re.compile(r"[+-]?[0-9]+")
_FLOAT = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?\.inf|\.nan", re.IGNORECASE)
_LARGEST = 2**63
_DIGITS = 19


def plain_value(node: Node) -> Any:  # noqa: ANN401, any value of YAML
    """Return the node as dicts, lists, text, numbers, truth values and None."""
    if isinstance(node.value, dict):
        return {key: plain_value(entry) for key, entry in node.value.items()}
    if isinstance(node.value, list):
        return [plain_value(item) for item in node.value]
    return _scalar(node.value)


def _scalar(scalar: Scalar) -> Any:  # noqa: ANN401, any scalar of YAML
    text = scalar.text
    if not scalar.plain:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if (word := text.lower()) in _WORDS:
        raise ValueError(f"{quoted(text)}: write {word}, or put a text in quotes")
    if _INTEGER.fullmatch(text):
        if len(text.lstrip("+-0")) > _DIGITS or not -_LARGEST <= int(text) < _LARGEST:
            raise ValueError(f"{quoted(text)} does not fit into 64 bits")
        return int(text)
    if _FLOAT.fullmatch(text):
        if float(text) in (float("inf"), float("-inf")):
            raise ValueError(f"{quoted(text)} is too large for a number")
        return float(text)
    if _NOT_FINITE.fullmatch(text):
        raise ValueError(f"{quoted(text)} is no finite number; put a text in quotes")
    return text


Value: TypeAlias = Any
"""A plain value of the right type, or `_INVALID`."""
Notes: TypeAlias = Mapping[str, Any]
ListType: TypeAlias = types.ListType | types.VarTupleType | types.TupleType
_INVALID: Any = object()
"""Stands for a value that has a problem."""


class Where(Struct, frozen=True):
    """The value under validation."""

    name: str  # its keys from the top, with dots
    place: Location
    problems: list[FileProblem]
    notes: Notes = {}  # the notes on its type

    def inner(self, key: str | int, node: Node) -> Where:
        """Return an entry of this mapping or list."""
        step = f"[{key}]" if isinstance(key, int) else f".{quoted(key)[1:-1]}"
        name = f"{self.name}{step}".removeprefix(".")
        return Where(name, node.place, self.problems)

    def noted(self, notes: Notes) -> Where:
        """Return a copy with further notes."""
        return Where(self.name, self.place, self.problems, {**self.notes, **notes})

    def wrong(self, text: str) -> Value:
        """Add a problem that names the key; return no value."""
        message = f"{self.name}: {text}" if self.name else text
        self.problems.append(self.place.problem(message))
        return _INVALID


def validate(
    node: Node, kind: types.Type, problems: list[FileProblem], name: str = ""
) -> Value:
    """Return the plain SI value of `node`, whose type is `kind`.

    Every problem is added to `problems`. A wrong single value of an optional key is
    dropped, so that later checks find further problems. None is returned when
    something wrong cannot be dropped.
    """
    value = _value(node, kind, Where(name, node.place, problems))
    return None if value is _INVALID else value


def _value(node: Node, kind: types.Type, where: Where) -> Value:
    if isinstance(kind, types.Metadata):
        return _noted(node, kind, where)
    if type(kind) in _COLLECTIONS:
        return _COLLECTIONS[type(kind)](node, kind, where)
    scalar = node.value
    if not isinstance(scalar, Scalar) or (scalar.plain and not scalar.text):
        return where.wrong(f"must be a single value, not {_kind(node)}")
    try:
        return _SINGLE[type(kind)](scalar.text, kind, where.notes)
    except ValueError as error:
        return where.wrong(str(error))


def _noted(node: Node, kind: types.Metadata, where: Where) -> Value:
    notes = kind.extra or {}
    if "is_nullable" in notes and _is_null(node):
        return None
    value = _value(node, form_of(kind), where.noted(notes))
    if value is _INVALID or "read" not in notes:
        return value
    try:
        return notes["read"](value)
    except ValueError as error:
        return where.wrong(str(error))


def _struct(node: Node, kind: types.StructType, where: Where) -> Value:
    keys = keys_in(kind)
    if not isinstance(node.value, dict):
        return where.wrong(f"must be a mapping with {listed(keys)}, not {_kind(node)}")
    for name in [name for name in node.value if name not in keys]:
        where.inner(name, node.value[name]).wrong(
            f"unknown key {quoted(name)}{did_you_mean(name, keys)}; "
            f"keys: {listed(keys)}"
        )
    values: dict[str, Value] = {kind.tag_field: kind.tag} if kind.tag_field else {}
    is_right = True
    for name, key in keys.items():
        if name in node.value:
            entry = node.value[name]
            value = _value(entry, key.kind, where.inner(name, entry))
            if value is not _INVALID:
                _keep(values, name, key, value)
            elif key.is_required or _shape(key.kind) is not Scalar:
                is_right = False
        elif key.is_required:
            where.wrong(f"the key '{name}' is missing")
            is_right = False
    return values if is_right else _INVALID


def _keep(values: dict[str, Value], name: str, key: FileKey, value: Value) -> None:
    """Keep the value of a key as its field, or as entries of its field."""
    if key.is_entry and value is not None:
        entries = value if isinstance(value, dict) else {name: value}
        values.setdefault(key.field, {}).update(entries)
    elif value is not None:
        values[key.field] = value


def _dict(node: Node, kind: types.DictType, where: Where) -> Value:
    if not isinstance(node.value, dict):
        return where.wrong(f"must be a mapping, as in {{a: ...}}, not {_kind(node)}")
    right = _has_length(len(node.value), where)
    values = {}
    for key, entry in node.value.items():
        inner = where.inner(key, entry)
        named = Node(entry.place, Scalar(key, plain=False))
        right &= _value(named, kind.key_type, inner) is not _INVALID
        values[key] = _value(entry, kind.value_type, inner)
    return values if right and _INVALID not in values.values() else _INVALID


def _list(node: Node, kind: ListType, where: Where) -> Value:
    pair = kind.item_types if isinstance(kind, types.TupleType) else ()
    items = node.value if isinstance(node.value, list) else None
    if items is None or (pair and len(items) != len(pair)):
        of = f" of {len(pair)}" if pair else ""
        return where.wrong(f"must be a list{of}, as in [a, b], not {_kind(node)}")
    right = _has_length(len(items), where)
    kinds = pair or [kind.item_type] * len(items)  # type: ignore[union-attr]
    values = [
        _value(item, item_kind, where.inner(i, item))
        for i, (item, item_kind) in enumerate(zip(items, kinds, strict=True))
    ]
    return values if right and _INVALID not in values else _INVALID


def _union(node: Node, kind: types.UnionType, where: Where) -> Value:
    """Choose the member by the shape of the node, and among records by their tags."""
    records = [member for member in kind.types if _tag(member)]
    members = {_shape(m): m for m in kind.types if m not in records}
    if records and (isinstance(node.value, dict) or not members):
        return _tagged(node, records, where)
    if None in members and _is_null(node):
        return None
    shape = type(node.value) if type(node.value) in members else next(iter(members))
    member = members[shape]
    if records and isinstance(member, types.LiteralType):
        where = where.noted({"or": [_tag(record) for record in records]})
    return _value(node, member, where)


def _tagged(node: Node, kinds: Sequence[types.Type], where: Where) -> Value:
    """Choose among records by the one key that is the tag of one of them."""
    tags = {_tag(kind): kind for kind in kinds}
    if not isinstance(node.value, dict):
        return where.wrong(
            f"must be a mapping with one of {listed(tags)}, not {_kind(node)}"
        )
    present = [key for key in node.value if key in tags]
    if len(present) != 1:
        keys = " and ".join(map(quoted, present or node.value)) or "nothing"
        guesses = (did_you_mean(key, tags) for key in node.value if not present)
        likely = next(filter(None, guesses), "")
        return where.wrong(f"has {keys}{likely}; it takes one of {listed(tags)}")
    return _value(node, tags[present[0]], where)


def _tag(kind: types.Type) -> str:
    """Return the key that tells a record from the others of its union, if any."""
    return str(kind.tag or "") if isinstance(kind, types.StructType) else ""


def _anything(node: Node, _kind: types.AnyType, where: Where) -> Value:
    try:
        return plain_value(node)
    except ValueError as error:
        return where.wrong(str(error))


def _has_length(length: int, where: Where) -> bool:
    least, most = where.notes.get("min_length", 0), where.notes.get("max_length")
    if least <= length and (most is None or length <= most):
        return True
    wanted = f"at least {least}" if length < least else f"at most {most}"
    entries = "1 entry" if length == 1 else f"{length} entries"
    where.wrong(f"has {entries}; it takes {wanted}")
    return False


def _text(text: str, _kind: types.StrType, notes: Notes) -> str:
    if len(text) < notes.get("min_length", 0):
        raise ValueError("is empty")
    if "pattern" in notes and not re.fullmatch(notes["pattern"], text):
        wanted = notes.get("expected", notes["pattern"])
        raise ValueError(f"{quoted(text)} is not allowed; write {wanted}")
    return text


def _number(text: str, _kind: types.FloatType, notes: Notes) -> float:
    return _in_range(parse(text, notes["dimension"]), text, notes)


def _integer(text: str, _kind: types.IntType, notes: Notes) -> float:
    if not re.fullmatch(r"[+-]?[0-9]{1,15}", text):
        raise ValueError(f"{quoted(text)} is not a whole number")
    return _in_range(int(text), text, notes)


def _truth(text: str, _kind: types.BoolType, _notes: Notes) -> bool:
    if text not in ("true", "false"):
        raise ValueError(f"{quoted(text)} is neither 'true' nor 'false'")
    return text == "true"


def _choice(text: str, kind: types.LiteralType, notes: Notes) -> str:
    choices = [str(value) for value in kind.values]
    if text not in choices:
        likely = did_you_mean(text, choices)
        if tags := notes.get("or"):
            likely += f", nor a mapping with one of {listed(tags)}"
        one_of = "one of " if len(choices) > 1 else ""
        raise ValueError(f"{quoted(text)} is not {one_of}{listed(choices)}{likely}")
    return text


_LIMITS: Mapping[str, tuple[str, Callable[[float, float], bool]]] = {
    "gt": ("above", operator.gt),
    "ge": ("at least", operator.ge),
    "lt": ("below", operator.lt),
    "le": ("at most", operator.le),
}


def _in_range(value: float, text: str, notes: Notes) -> float:
    for name, (words, holds) in _LIMITS.items():
        if name in notes and not holds(value, notes[name]):
            unit = " s" if notes.get("dimension") is SECONDS else ""
            raise ValueError(f"{quoted(text)} must be {words} {notes[name]:g}{unit}")
    return value


def _kind(node: Node) -> str:
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, list):
        return f"a list of {len(node.value)}"
    return quoted(node.value.text) if node.value.text else "nothing"


def _is_null(node: Node) -> bool:
    scalar = node.value
    return isinstance(scalar, Scalar) and scalar.plain and scalar.text in NULLS


def _shape(kind: types.Type) -> type | None:
    """Return the type of `Node.value` in which a value of `kind` is written."""
    if isinstance(kind, types.Metadata):
        return _shape(form_of(kind))
    return _SHAPES.get(type(kind), Scalar)


_SHAPES = {
    types.StructType: dict,
    types.DictType: dict,
    types.ListType: list,
    types.VarTupleType: list,
    types.TupleType: list,
    types.NoneType: None,
}
_COLLECTIONS: Mapping[type, Any] = {
    types.StructType: _struct,
    types.DictType: _dict,
    types.ListType: _list,
    types.VarTupleType: _list,
    types.TupleType: _list,
    types.UnionType: _union,
    types.AnyType: _anything,
}
_SINGLE: Mapping[type, Any] = {
    types.StrType: _text,
    types.FloatType: _number,
    types.IntType: _integer,
    types.BoolType: _truth,
    types.LiteralType: _choice,
}
