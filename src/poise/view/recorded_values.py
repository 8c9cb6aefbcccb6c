"""What messages are in a recording: JSON with all values, and pictures for Foxglove."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from typing import Any

from poise.wire.recording_file import Schema

MOST_LISTED = 1_000
"""Arrays of more values are written as bytes, with their type and shape."""
TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}
_BYTES = {"type": "string", "contentEncoding": "base64"}
_TEXT, _NUMBER = {"type": "string"}, {"type": "integer"}
_RAW = {
    "title": "foxglove.RawImage",
    "type": "object",
    "properties": {
        "timestamp": TIME,
        "frame_id": _TEXT,
        "width": _NUMBER,
        "height": _NUMBER,
        "encoding": _TEXT,
        "step": _NUMBER,
        "data": _BYTES,
    },
}
_COMPRESSED = {
    "title": "foxglove.CompressedImage",
    "type": "object",
    "properties": {
        "timestamp": TIME,
        "frame_id": _TEXT,
        "data": _BYTES,
        "format": _TEXT,
    },
}
"""Foxglove's own schemas of pictures."""
_ENCODINGS = {
    ("uint8", 1): "mono8",
    ("uint16", 1): "mono16",
    ("float32", 1): "32FC1",
    ("uint8", 3): "rgb8",
    ("uint8", 4): "rgba8",
}
_SIGNATURES = {b"\xff\xd8\xff": "jpeg", b"\x89PNG": "png", b"RIFF": "webp"}
_SMALLEST = 8
"""A picture has at least so many pixels each way; what is smaller is a matrix."""


def stamp(at: float) -> dict[str, int]:
    """Return a moment [s since 1970] as Foxglove has it."""
    return {"sec": int(at), "nsec": int((at - int(at)) * 1e9)}


def as_json(value: Any) -> Any:  # noqa: ANN401, any message
    """Return a value as JSON has it: all of it."""
    if isinstance(value, Mapping):
        return {str(name): as_json(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(part) for part in value]
    if isinstance(value, bytes | bytearray | memoryview):
        return _base64(value)
    if not _is_array(value):
        return value
    if value.size <= MOST_LISTED:
        return value.tolist()
    shape, data = list(value.shape), _base64(value.tobytes())
    return {"dtype": value.dtype.str, "shape": shape, "data": data}


def pictures(
    value: Any,  # noqa: ANN401, any message
    at: float,
    name: str = "",
) -> Iterator[tuple[str, Schema, dict[str, Any]]]:
    """Yield the pictures in a message: each's path in it, schema, and content."""
    if isinstance(value, Mapping):
        for part, inner in value.items():
            yield from pictures(inner, at, f"{name}/{part}" if name else str(part))
    elif isinstance(value, bytes):
        for signature, format_ in _SIGNATURES.items():
            if value.startswith(signature):
                data = _base64(value)
                content = {"timestamp": stamp(at), "frame_id": "", "data": data}
                yield name, _COMPRESSED, content | {"format": format_}
    elif _is_array(value) and (encoding := _encoding(value)):
        yield (
            name,
            _RAW,
            {
                "timestamp": stamp(at),
                "frame_id": "",
                "width": value.shape[1],
                "height": value.shape[0],
                "encoding": encoding,
                "step": value.nbytes // value.shape[0],
                "data": _base64(value.tobytes()),
            },
        )


def _encoding(array: Any) -> str:  # noqa: ANN401, NumPy need not be there
    """Return how an array is a picture; empty: it is none."""
    if array.ndim not in {2, 3} or min(array.shape[:2]) < _SMALLEST:
        return ""
    channels = array.shape[2] if array.ndim == len("hwc") else 1
    return _ENCODINGS.get((array.dtype.name, channels), "")


def _is_array(value: Any) -> bool:  # noqa: ANN401, NumPy need not be there
    return hasattr(value, "dtype") and hasattr(value, "tobytes")


def _base64(data: bytes | bytearray | memoryview) -> str:
    return base64.b64encode(data).decode()
