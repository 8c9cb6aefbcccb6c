"""Fields that are written in another form than they have, and how they are read."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

from msgspec import Meta, Struct

from poise.model.file_keys import (
    EndText,
    Name,
    PortName,
    Reference,
    Share,
    note,
    written,
)
from poise.units import quoted

PortKind = Literal["provides", "requires", "publishes", "subscribes"]


def by_name(record: type[Struct]) -> Meta:
    """Return a note: records are the entries of a mapping, whose keys are names."""
    return written(
        dict[Name, record],  # type: ignore[valid-type]
        lambda entries: [{"name": name, **each} for name, each in entries.items()],
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
    """Return resource -> share; a single share is that of CPU and memory.

    Of a countable resource, a share would leave a part that nothing can use.
    """
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
