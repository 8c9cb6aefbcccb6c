"""The JSON Schema (draft 2020-12) of robot files, from the keys of the records."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from typing import Any

from msgspec import inspect as types

from poise.model.file_keys import FileKey, form_of, keys_in
from poise.model.robot import Robot
from poise.units import NUMBER

Schema = dict[str, Any]
_NUMBER = r"\s*\+?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\s*"
_LIMITS = {
    "gt": "exclusiveMinimum",
    "ge": "minimum",
    "lt": "exclusiveMaximum",
    "le": "maximum",
    "pattern": "pattern",
}
_SINGLE = {
    types.StrType: "string",
    types.IntType: "integer",
    types.BoolType: "boolean",
    types.NoneType: "null",
}


def schema() -> Schema:
    """Return the schema as plain data.

    It requires no key at the top, because each may be in another included file.
    """
    records: dict[str, Schema] = {}
    top = _schema(types.type_info(Robot), {}, records)
    records["Robot"]["required"] = []
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Poise robot file",
        **top,
        "$defs": records,
    }


def schema_text() -> str:
    """Return the schema as it is published, one key a line."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def flush_left(records: Mapping[str, Schema]) -> dict[str, Schema]:
    """Return msgspec's schemas of records with their docstrings as people read them.

    Python leaves the indentation of the code in a docstring, from 3.13 on it does not.
    """
    return {
        name: {**record, "description": inspect.cleandoc(record["description"])}
        if "description" in record
        else record
        for name, record in records.items()
    }


def _schema(
    kind: types.Type, notes: Mapping[str, Any], records: dict[str, Schema]
) -> Schema:
    """Return the schema of a type with its notes; add its records to `records`."""
    if isinstance(kind, types.Metadata):
        return _noted(kind, notes, records)
    if isinstance(kind, types.StructType):
        return _record(kind, records)
    if isinstance(kind, types.UnionType):
        return {"anyOf": [_schema(part, notes, records) for part in kind.types]}
    if isinstance(kind, types.DictType):
        return {
            "type": "object",
            "propertyNames": _schema(kind.key_type, {}, records),
            "additionalProperties": _schema(kind.value_type, {}, records),
            **_limits(notes, "Properties"),
        }
    if isinstance(kind, types.VarTupleType | types.ListType):
        items = _schema(kind.item_type, {}, records)
        return {"type": "array", "items": items, **_limits(notes, "Items")}
    return _single(kind, notes, records)


def _single(
    kind: types.Type, notes: Mapping[str, Any], records: dict[str, Schema]
) -> Schema:
    if isinstance(kind, types.TupleType):
        both = [_schema(item, {}, records) for item in kind.item_types]
        length = {"minItems": len(both), "maxItems": len(both)}
        return {"type": "array", **length, "prefixItems": both, "items": False}
    if isinstance(kind, types.FloatType):
        return _quantity(notes)
    if isinstance(kind, types.LiteralType):
        return {"enum": list(kind.values)}
    made = {"type": _SINGLE[type(kind)]} if type(kind) in _SINGLE else {}
    return {**made, **_limits(notes, "Length")}


def _noted(
    kind: types.Metadata, around: Mapping[str, Any], records: dict[str, Schema]
) -> Schema:
    own = kind.extra or {}
    made = _schema(form_of(kind), {**around, **own}, records)
    if "is_nullable" in own:
        made = {"anyOf": [*made.get("anyOf", [made]), {"type": "null"}]}
    if "examples" in own:
        made = {"examples": list(own["examples"]), **made}
    return {"description": own["says"], **made} if "says" in own else made


def _record(kind: types.StructType, records: dict[str, Schema]) -> Schema:
    name = kind.cls.__name__.removesuffix("Keys")
    if name not in records:
        records[name] = {}  # keeps its place before the records in it
        keys = keys_in(kind)
        records[name].update(
            title=name,
            description=(kind.cls.__doc__ or "").partition("\n")[0],
            type="object",
            properties={key: _property(entry, records) for key, entry in keys.items()},
            required=[key for key, entry in keys.items() if entry.is_required],
            additionalProperties=False,
        )
    return {"$ref": f"#/$defs/{name}"}


def _property(key: FileKey, records: dict[str, Schema]) -> Schema:
    made = _schema(key.kind, {}, records)
    is_plain = isinstance(key.default, str | float | int) and key.default != ""
    return {**made, "default": key.default} if is_plain else made


def _quantity(notes: Mapping[str, Any]) -> Schema:
    """Allow a number with a unit to be a number or a text with its unit."""
    limits = _limits(notes, "")
    if "exclusiveMinimum" not in limits:
        limits["minimum"] = 0
    if notes["dimension"] is NUMBER:
        return {"type": "number", **limits}
    units = "|".join(sorted(unit for unit in notes["dimension"].units if unit))
    pattern = f"^{_NUMBER}({units})?\\s*$"
    return {"type": ["number", "string"], **limits, "pattern": pattern}


def _limits(notes: Mapping[str, Any], counted: str) -> Schema:
    lengths = {"min_length": f"min{counted}", "max_length": f"max{counted}"}
    words = {**_LIMITS, **lengths}
    return {word: notes[name] for name, word in words.items() if name in notes}
