"""Writes Protocol Buffers, with the description of the types that readers need."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

_TYPES = {
    "double": 1,
    "int64": 3,
    "int32": 5,
    "fixed32": 7,
    "string": 9,
    "message": 11,
    "bytes": 12,
    "enum": 14,
}
"""How a description numbers them."""
_PACKED = {"double": (1, struct.Struct("<d")), "fixed32": (5, struct.Struct("<I"))}
_VARINT, _SIZED = 0, 2
"""How values are written that have no fixed size."""
_OPTIONAL, _REPEATED = 1, 3
_MORE = 0x80
"""Set in each byte of a number but the last."""


class ProtobufEnum(NamedTuple):
    """An enumeration: ``package.Name``, and what its numbers from 0 on mean."""

    name: str
    values: tuple[str, ...]


class ProtobufField(NamedTuple):
    """A field: its number, and a name of `_TYPES`, or the enumeration or message."""

    number: int
    type: str | ProtobufEnum | ProtobufType
    is_list: bool = False


class ProtobufType(NamedTuple):
    """A message: ``package.Name``, and its fields."""

    name: str
    fields: Mapping[str, ProtobufField]

    def encode(self, value: Mapping[str, Any]) -> bytes:
        """Return an object with a part for each field; what is empty is left out."""
        return b"".join(
            _encoded(field, each)
            for name, field in self.fields.items()
            for each in (value[name] if field.is_list else [value[name]])
            if each or field.is_list
        )

    def description(self) -> bytes:
        """Return the type, and all types in it, as a ``FileDescriptorSet``."""
        files: dict[str, dict[str, Any]] = {}
        for type_ in dict.fromkeys(_inner(self)):
            package, _, name = type_.name.rpartition(".")
            before = list(files)
            empty = {"dependency": before, "message_type": [], "enum_type": []}
            file = files.setdefault(package, empty)
            if isinstance(type_, ProtobufEnum):
                values = [{"name": v, "number": i} for i, v in enumerate(type_.values)]
                file["enum_type"].append({"name": name, "value": values})
            else:
                fields = [_described(*each) for each in type_.fields.items()]
                file["message_type"].append({"name": name, "field": fields})
        named = [
            {"name": package, "package": package, "syntax": "proto3", **file}
            for package, file in files.items()
        ]
        return _FILES.encode({"file": named})

    def __hash__(self) -> int:
        return hash(self.name)


def _inner(type_: ProtobufType) -> Iterator[ProtobufType | ProtobufEnum]:
    """Yield the types in a type, and then itself."""
    for field in type_.fields.values():
        if isinstance(field.type, ProtobufType):
            yield from _inner(field.type)
        elif isinstance(field.type, ProtobufEnum):
            yield field.type
    yield type_


def _described(name: str, field: ProtobufField) -> dict[str, Any]:
    kind, name_of = field.type, ""
    if not isinstance(kind, str):
        name_of = f".{kind.name}"
        kind = "enum" if isinstance(kind, ProtobufEnum) else "message"
    return {
        "name": name,
        "number": field.number,
        "label": _REPEATED if field.is_list else _OPTIONAL,
        "type": _TYPES[kind],
        "type_name": name_of,
    }


def _encoded(field: ProtobufField, value: Any) -> bytes:  # noqa: ANN401, of its type
    if isinstance(field.type, ProtobufType):
        value = field.type.encode(value)
    elif isinstance(field.type, ProtobufEnum) or field.type.startswith("int"):
        return _varint(field.number << 3 | _VARINT) + _varint(value)
    elif field.type in _PACKED:
        wire, layout = _PACKED[field.type]
        return _varint(field.number << 3 | wire) + layout.pack(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(field.number << 3 | _SIZED) + _varint(len(data)) + data


def _varint(number: int) -> bytes:
    """Return a natural number, seven bits a byte, the lowest first."""
    data = bytearray()
    while number >= _MORE:
        data.append(number % _MORE | _MORE)
        number //= _MORE
    data.append(number)
    return bytes(data)


_FIELD = ProtobufType(
    "google.protobuf.FieldDescriptorProto",
    {
        "name": ProtobufField(1, "string"),
        "number": ProtobufField(3, "int32"),
        "label": ProtobufField(4, "int32"),
        "type": ProtobufField(5, "int32"),
        "type_name": ProtobufField(6, "string"),
    },
)
_MESSAGE = ProtobufType(
    "google.protobuf.DescriptorProto",
    {
        "name": ProtobufField(1, "string"),
        "field": ProtobufField(2, _FIELD, is_list=True),
    },
)
_VALUE = ProtobufType(
    "google.protobuf.EnumValueDescriptorProto",
    {"name": ProtobufField(1, "string"), "number": ProtobufField(2, "int32")},
)
_ENUM = ProtobufType(
    "google.protobuf.EnumDescriptorProto",
    {
        "name": ProtobufField(1, "string"),
        "value": ProtobufField(2, _VALUE, is_list=True),
    },
)
_FILE = ProtobufType(
    "google.protobuf.FileDescriptorProto",
    {
        "name": ProtobufField(1, "string"),
        "package": ProtobufField(2, "string"),
        "dependency": ProtobufField(3, "string", is_list=True),
        "message_type": ProtobufField(4, _MESSAGE, is_list=True),
        "enum_type": ProtobufField(5, _ENUM, is_list=True),
        "syntax": ProtobufField(12, "string"),
    },
)
_FILES = ProtobufType(
    "google.protobuf.FileDescriptorSet",
    {"file": ProtobufField(1, _FILE, is_list=True)},
)
