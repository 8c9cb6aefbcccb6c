"""How the fields of a robot's records are written in its file.

A field whose type has a description (`says`) is a key of the file. Validator, schema
and loader follow from these notes; msgspec ignores them.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, structs
from msgspec import inspect as types

from poise import units
from poise.endpoint import NAME, NAME_SAYS
from poise.units import quoted


def says(text: str, **notes: object) -> Meta:
    """Return the description of a key, which an editor shows, and further notes."""
    return Meta(extra={"says": text, **notes})


def note(**notes: object) -> Meta:
    """Return notes for a type within a field's type."""
    return Meta(extra=notes)


class Form:
    """The form in which a field is written.

    It is looked into when it is first asked for: records may contain themselves.
    """

    def __init__(self, form: object) -> None:
        self._form = form

    @cached_property
    def kind(self) -> types.Type:
        """Its type."""
        return types.type_info(self._form)


def form_of(kind: types.Metadata) -> types.Type:
    """Return the type in which a value of a type with notes is written."""
    form = (kind.extra or {}).get("form")
    return form.kind if isinstance(form, Form) else kind.type


def written(form: object, read: Callable[[Any], Any]) -> Meta:
    """Return a note that a field is written as `form`."""
    return Meta(extra={"form": Form(form), "read": read})


def entries(record: type[Struct]) -> Meta:
    """Return a note that a mapping is written as the keys of `record`."""
    return Meta(extra={"entries": record})


def _text(pattern: str, expected: str, *examples: str) -> Meta:
    return note(pattern=f"^{pattern}$", expected=expected, examples=examples)


def _quantity(dimension: units.Dimension) -> Meta:
    return note(dimension=dimension, examples=tuple(dimension.example.split(" or ")))


Name = Annotated[str, _text(NAME, NAME_SAYS, "main", "laser_scanner")]
Resource = Annotated[
    str,
    _text(
        rf"(?!(cpu|memory)$){NAME}",
        f"{NAME_SAYS}; cpu and memory have keys of their own",
        "gpu",
    ),
]
PortName = Annotated[str, note(pattern=r"^\w{1,63}$")]
_CLASS = "package.module:Class"
_FUNCTION = "package.module:function"
_REFERENCE = r"\w+(\.\w+)*:\w+(\.\w+)*"
Reference = Annotated[str, _text(_REFERENCE, _CLASS, _CLASS)]
FunctionReference = Annotated[str, _text(_REFERENCE, _FUNCTION, _FUNCTION)]
EndText = Annotated[
    str,
    _text(
        rf"{NAME}(\.\w{{1,63}})?", "component.port, or only component", "localiser.scan"
    ),
]
Cores = Annotated[float, _quantity(units.CORES)]
Bytes = Annotated[float, _quantity(units.BYTES)]
Seconds = Annotated[float, _quantity(units.SECONDS)]
Rate = Annotated[float, _quantity(units.RATE)]
Bandwidth = Annotated[float, _quantity(units.BANDWIDTH)]
Share = Annotated[float, _quantity(units.RATIO)]
Amount = Annotated[float, _quantity(units.NUMBER)]
Address = Annotated[str, note(examples=("10.0.0.1", "[fd00::2]:7447"))]


class FileKey(Struct, frozen=True):
    """A key of the file, and the field of the record that it belongs to."""

    field: str
    kind: types.Metadata
    default: object
    is_required: bool
    is_entry: bool = False  # whether `field` is a mapping with several keys


_FOUND: dict[type, Mapping[str, FileKey]] = {}


def keys_of(record: type[Struct]) -> Mapping[str, FileKey]:
    """Return the keys of a record in the file, by name."""
    return keys_in(record_of(record))


@cache
def record_of(record: type[Struct]) -> types.StructType:
    """Return what is known of a record, and of all records in it: that takes long."""
    kind = types.type_info(record)
    assert isinstance(kind, types.StructType)  # noqa: S101, as any record is
    return kind


def keys_in(kind: types.StructType) -> Mapping[str, FileKey]:
    """Return the keys of a record of which it is known what it is."""
    if kind.cls not in _FOUND:
        _FOUND[kind.cls] = _keys(kind)
    return _FOUND[kind.cls]


def _keys(kind: types.StructType) -> Mapping[str, FileKey]:
    keys: dict[str, FileKey] = {}
    for field in kind.fields:
        if not isinstance(field.type, types.Metadata):
            continue
        notes = field.type.extra or {}
        if "entries" in notes:
            for name, entry in keys_of(notes["entries"]).items():
                keys[name] = structs.replace(entry, field=field.name, is_entry=True)
        elif "says" in notes:
            keys[notes.get("key", field.name)] = FileKey(
                field.name,
                field.type,
                field.default,
                field.required or "is_required" in notes,
            )
    return keys


PortKind = Literal["provides", "requires", "publishes", "subscribes"]


def by_name(record: type[Struct]) -> Meta:
    """Return a note: records are the entries of a mapping, whose keys are names."""
    return written(
        dict[Name, record],  # type: ignore[valid-type]
        lambda entries: [{"name": name, **entry} for name, entry in entries.items()],
    )


def by_port(record: type[Struct]) -> Meta:
    """Return a note: records are the entries of a mapping, whose keys are ports."""
    return written(
        dict[EndText, record],  # type: ignore[valid-type]
        lambda entries: [{"port": _end(text), **e} for text, e in entries.items()],
    )


def _command(text: str | Sequence[str]) -> list[str]:
    """Return the words of a command line, split as a shell does."""
    if not isinstance(text, str):
        return list(text)
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ValueError(f"{quoted(text)} is not a command line: {error}") from None
    if not words:
        raise ValueError("is empty")
    return words


def _end(text: str) -> dict[str, str]:
    component, _, port = text.partition(".")
    return {"component": component, "port": port}


def _ports(entries: Mapping[str, Mapping[str, str]]) -> list[dict[str, str]]:
    return [
        {"name": name, "kind": kind, "type": reference}
        for name, port in entries.items()
        for kind, reference in port.items()
    ]


def _reserve(share: float | Mapping[str, float]) -> Mapping[str, float]:
    """Return resource -> share; a single share is that of CPU and memory."""
    if isinstance(share, Mapping):
        return share
    return dict.fromkeys(("cpu", "memory"), share) if share else {}


COMMAND = written(
    Annotated[str, note(min_length=1)] | Annotated[list[str], note(min_length=1)],
    _command,
)
END = written(EndText, _end)
ENDS = written(tuple[EndText, EndText], lambda pair: [_end(text) for text in pair])
PORTS = written(
    dict[
        PortName, Annotated[dict[PortKind, Reference], note(min_length=1, max_length=1)]
    ],
    _ports,
)
_SHARE = Annotated[Share, note(lt=1)]
RESERVE = written(_SHARE | dict[Name, _SHARE], _reserve)
