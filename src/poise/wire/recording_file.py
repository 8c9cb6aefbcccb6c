"""The file of a recording: records one after another, so that it grows as it is made.

Each is a `Recorded` behind its length; together they are the recording. What a killed
run left ends with its last whole record.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.errors import RunError, UsageError
from poise.wire.records.sample_records import AgentSample


class Input(Struct, frozen=True, array_like=True):
    """A message that was published, or a call that came.

    Parameters
    ----------
    source
        ``component.port`` that published it, or that called.
    at
        When it came [s], since the recording began.
    body, buffers
        It, or the arguments, encoded (`poise.wire.codec`); buffers end to end.
    tag
        Of a call: which method (`poise.runtime.connectors.interface`).
    result
        What a call returned, encoded without its arrays; empty: it failed, or nobody
        waited for it.
    """

    source: str
    at: float
    body: bytes
    buffers: bytes
    tag: int | None = None
    result: bytes = b""


class Recorded(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that was recorded of one run, oldest first.

    Parameters
    ----------
    samples
        What the agents sampled.
    inputs
        What was published between architectures, and called.
    seen
        What policies saw, five times a second: `poise.model.policy.policy.Seen`, as
        msgpack, compressed by zlib.
    """

    version: int = 1
    robot: str
    samples: list[AgentSample] = []
    inputs: list[Input] = []
    seen: list[bytes] = []


log = logging.getLogger(__name__)

_LENGTH = 4
_decode = msgspec.msgpack.Decoder(Recorded).decode


def packed(part: Recorded) -> bytes:
    """Return a part of a recording as it is in the file."""
    data = msgspec.msgpack.encode(part)
    return len(data).to_bytes(_LENGTH, "little") + data


def append(part: Recorded, path: Path) -> None:
    """Write a part at the end of a recording, which is begun where there is none.

    Raises
    ------
    RunError
        It cannot be written, for instance because the disk is full.
    """
    try:
        with path.open("ab") as file:
            file.write(packed(part))
    except OSError as error:
        raise RunError(
            f"the recording {path} cannot be written: {error.strerror}"
        ) from error


def parts_of(path: Path) -> Iterator[Recorded]:
    """Yield the parts of a recording, in order; each is read when it is asked for.

    A last one that is not whole is left out, with a warning.

    Raises
    ------
    UsageError
        It cannot be read, or is no recording.
    """
    count = 0
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            while head := file.read(_LENGTH):
                length = int.from_bytes(head, "little")
                data = file.read(min(length, size))
                if len(head) < _LENGTH or len(data) < length:
                    break
                yield _decode(data)
                count += 1
    except OSError as error:
        raise UsageError(f"recording {path} cannot be read: {error}") from error
    except msgspec.DecodeError as error:
        raise UsageError(f"{path} is no recording: {error}") from error
    if not count:
        raise UsageError(f"{path} is no recording, or one of an earlier version")
    if head:
        log.warning("the recording %s ends within a record, which is left out", path)


def load(path: Path) -> Recorded:
    """Return the whole recording in a file; raises as `parts_of` does."""
    first, *others = parts_of(path)
    for part in others:
        first.samples.extend(part.samples)
        first.inputs.extend(part.inputs)
        first.seen.extend(part.seen)
    return first
