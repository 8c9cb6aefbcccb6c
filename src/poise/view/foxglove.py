"""What viewers draw of a message: pictures, poses, transforms and point clouds.

In Foxglove's types of Protocol Buffers, which Foxglove and Rerun draw.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from poise.wire.recording_file import Schema, extra

if TYPE_CHECKING:
    from google.protobuf.message import Message

_TEXT, _INTEGER = {"type": "string"}, {"type": "integer"}


def _foxglove(title: str, **properties: Schema) -> Schema:
    return {"type": "object", "title": title, "properties": properties}


LOG = _foxglove(
    "foxglove.Log",
    timestamp=_foxglove("time", sec=_INTEGER, nsec=_INTEGER),
    level=_INTEGER,
    message=_TEXT,
    name=_TEXT,
    file=_TEXT,
    line=_INTEGER,
)
"""Foxglove's own schema of log messages. What the manager knew when it decided is no
part of it, for Foxglove refuses schemas of objects whose parts are not known."""

_ENCODINGS = {
    ("uint8", 1): "mono8",
    ("uint16", 1): "mono16",
    ("float32", 1): "32FC1",
    ("uint8", 3): "rgb8",
    ("uint8", 4): "rgba8",
}
_SIGNATURES = {b"\xff\xd8\xff": "jpeg", b"\x89PNG": "png", b"RIFF": "webp"}
_SMALLEST = 8
"""The least width and height of a picture [pixels]; a smaller array is a matrix."""
_CLOUD_NAMES = {"points", "cloud"}
_CLOUD_FIELDS = ("x", "y", "z", "intensity")
_CLOUD_TYPES = {"float32": 7, "float64": 8}
"""NumPy's name of a type -> Foxglove's number of it."""
_ANGLES = ("heading", "theta", "yaw")
_ORIGIN = {
    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}

Parts = Mapping[str, Any]
Vector = dict[str, float]


class FoxglovePart(NamedTuple):
    """What viewers draw of a part of a message; `kind`: the topic's first part.

    `name`: of its type in the package ``foxglove``.
    """

    kind: str
    part: str
    name: str
    content: dict[str, Any]

    @property
    def type(self) -> type[Message]:
        """Its type of Protocol Buffers."""
        module = extra(f"foxglove_schemas_protobuf.{self.name}_pb2")
        type_: type[Message] = getattr(module, self.name)
        return type_


def stamp(at: float) -> dict[str, int]:
    """Return a moment [s since 1970] as Foxglove has it."""
    return {"sec": int(at), "nsec": int((at - int(at)) * 1e9)}


def _timestamp(at: float) -> dict[str, int]:
    return {"seconds": int(at), "nanos": int((at - int(at)) * 1e9)}


def drawings(
    value: Any,  # noqa: ANN401, any message
    at: float,
    part: str = "",
    frame: str = "",
) -> Iterator[FoxglovePart]:
    """Yield what Foxglove draws of a message that went out `at` [s since 1970]."""
    if isinstance(value, Mapping):
        frame = _frame(value) or frame
        yield from _placed(value, at, part, frame)
        for name, inner in value.items():
            within = f"{part}/{name}" if part else str(name)
            yield from drawings(inner, at, within, frame)
    elif isinstance(value, list | tuple):
        if part.rpartition("/")[2] == "transforms":
            for inner in value:
                yield from drawings(inner, at, part, frame)
    elif isinstance(value, bytes):
        for signature, format_ in _SIGNATURES.items():
            if value.startswith(signature):
                content = {"data": value, "format": format_}
                yield _drawing("pictures", part, "CompressedImage", at, frame, content)
    elif is_array(value):
        yield from _of_array(value, at, part, frame)


def is_array(value: Any) -> bool:  # noqa: ANN401, NumPy need not be there
    """Return whether a value is an array of NumPy."""
    return hasattr(value, "dtype") and hasattr(value, "tobytes")


def base64_of(data: bytes | bytearray | memoryview) -> str:
    """Return bytes in base64."""
    return base64.b64encode(data).decode()


def _drawing(
    kind: str, part: str, name: str, at: float, frame: str, content: dict[str, Any]
) -> FoxglovePart:
    common = {"timestamp": _timestamp(at), "frame_id": frame}
    return FoxglovePart(kind, part, name, common | content)


def _placed(value: Parts, at: float, part: str, frame: str) -> Iterator[FoxglovePart]:
    """Yield the pose or the transform that an object is."""
    child = value.get("child_frame_id")
    # ROS 2 has a `transform` within
    moved = value.get("transform", value)
    moved = moved if isinstance(moved, Mapping) else value
    translation = _vector(moved.get("translation"))
    rotation = _rotation(moved.get("rotation"))
    if isinstance(child, str) and translation and rotation:
        parent = value.get("parent_frame_id")
        content = {
            "timestamp": _timestamp(at),
            "parent_frame_id": parent if isinstance(parent, str) else frame,
            "child_frame_id": child,
            "translation": translation,
            "rotation": rotation,
        }
        yield FoxglovePart("transforms", part, "FrameTransform", content)
    elif pose := _pose(value):
        yield _drawing("poses", part, "PoseInFrame", at, frame, {"pose": pose})


def _pose(value: Parts) -> dict[str, Vector]:
    """Return the pose that an object is; empty: it is none."""
    position = _vector(value.get("position"))
    orientation = _rotation(value.get("orientation"))
    if position and orientation:
        return {"position": position, "orientation": orientation}
    angle = next((value[name] for name in _ANGLES if name in value), None)
    position = _vector(value)
    if not position or not isinstance(angle, int | float) or math.isinf(angle):
        return {}
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(angle / 2), "w": math.cos(angle / 2)}
    return {"position": position, "orientation": turn}


def _of_array(array: Any, at: float, part: str, frame: str) -> Iterator[FoxglovePart]:  # noqa: ANN401, of NumPy
    """Yield the picture or the point cloud that an array is."""
    if fields := _cloud_fields(array, part):
        size = array.dtype.itemsize
        number = _CLOUD_TYPES[array.dtype.name]
        content = {
            "pose": _ORIGIN,
            "point_stride": size * len(fields),
            "fields": [
                {"name": name, "offset": i * size, "type": number}
                for i, name in enumerate(fields)
            ],
            "data": array.tobytes(),
        }
        yield _drawing("clouds", part, "PointCloud", at, frame, content)
    elif encoding := _encoding(array):
        content = {
            "width": array.shape[1],
            "height": array.shape[0],
            "encoding": encoding,
            "step": array.nbytes // array.shape[0],
            "data": array.tobytes(),
        }
        yield _drawing("pictures", part, "RawImage", at, frame, content)


def _cloud_fields(array: Any, part: str) -> tuple[str, ...]:  # noqa: ANN401, of NumPy
    """Return what the columns of a point cloud are; empty: it is none."""
    is_named = part.rpartition("/")[2] in _CLOUD_NAMES
    if not is_named or array.dtype.name not in _CLOUD_TYPES:
        return ()
    is_table = array.ndim == len(("point", "field")) and array.shape[1] in {3, 4}
    return _CLOUD_FIELDS[: array.shape[1]] if is_table else ()


def _encoding(array: Any) -> str:  # noqa: ANN401, of NumPy
    """Return how an array is a picture; empty: it is none."""
    if array.ndim not in {2, 3} or min(array.shape[:2]) < _SMALLEST:
        return ""
    channels = array.shape[2] if array.ndim == len("hwc") else 1
    return _ENCODINGS.get((array.dtype.name, channels), "")


def _frame(value: Parts) -> str:
    """Return the frame that an object or its header names; empty: none."""
    header = value.get("header")
    named = value.get("frame_id") or (
        header.get("frame_id") if isinstance(header, Mapping) else None
    )
    return named if isinstance(named, str) else ""


def _vector(value: Any) -> Vector:  # noqa: ANN401, any part
    """Return x, y and z, which may lack; empty: it is no vector."""
    flat = _numbers(value, "xy")
    return flat and {**flat, **(_numbers(value, "z") or {"z": 0.0})}


def _rotation(value: Any) -> Vector:  # noqa: ANN401, any part
    return _numbers(value, "xyzw")


def _numbers(value: Any, names: str) -> Vector:  # noqa: ANN401, any part
    """Return the named numbers of an object; empty: one lacks."""
    if not isinstance(value, Mapping):
        return {}
    found = {name: value.get(name) for name in names}
    is_whole = all(isinstance(number, int | float) for number in found.values())
    return {name: float(found[name] or 0.0) for name in names} if is_whole else {}
