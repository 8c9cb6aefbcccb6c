"""What Foxglove draws of a message."""

from __future__ import annotations

import base64
from math import pi
from typing import Any

import numpy as np
import pytest

from poise.view.foxglove import drawings

HALF = 0.5**0.5
ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}
UPRIGHT = {**ORIGIN, "w": 1.0}


def test_pictures_are_found_wherever_they_are() -> None:
    colours = np.zeros((10, 20, 3), np.uint8)
    jpeg = b"\xff\xd8\xff\xe0 and so on"
    message = {"left": {"pixels": colours}, "file": jpeg, "matrix": np.eye(3)}
    (_, name, schema, raw), (_, file, of_file, compressed) = drawings(message, 1.5)
    assert (name, schema["title"]) == ("left/pixels", "foxglove.RawImage")
    size = {"width": 20, "height": 10, "step": 60, "encoding": "rgb8"}
    assert raw.items() >= size.items()
    assert raw["timestamp"] == {"sec": 1, "nsec": 500_000_000}
    assert len(base64.b64decode(raw["data"])) == colours.nbytes
    assert (file, of_file["title"]) == ("file", "foxglove.CompressedImage")
    assert (compressed["format"], base64.b64decode(compressed["data"])) == (
        "jpeg",
        jpeg,
    )
    assert raw.keys() == schema["properties"].keys()
    assert compressed.keys() == of_file["properties"].keys()


def test_what_foxglove_does_not_draw_is_left_alone() -> None:
    for value in (
        np.eye(9),  # of doubles
        np.zeros((7, 20), np.uint8),
        np.zeros((9, 9, 2), np.uint8),
        np.zeros(100, np.uint8),
        b"GIF or other",
        np.zeros((20, 3), np.float32),  # called neither points nor cloud
        {"points": np.zeros((20, 2), np.float32)},
        {"x": 1.0, "y": 2.0},
        {"position": {"x": 1.0}, "orientation": {"x": 0.0, "y": 0.0}},
        {"child_frame_id": "arm", "translation": None, "rotation": None},
        "text",
    ):
        assert list(drawings({"value": value}, 0.0)) == []


def test_a_pose_on_the_floor_turns_about_the_vertical() -> None:
    message = {"stamp": 1, "x": 1, "y": 2.0, "heading": pi / 2}
    (drawn,) = drawings(message, 1.5)
    assert (drawn.kind, drawn.part) == ("poses", "")
    pose = drawn.content["pose"]
    assert pose["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    # the half of a quarter turn: sin 45 degrees, cos 45 degrees
    turn = {"x": 0.0, "y": 0.0, "z": HALF, "w": HALF}
    assert pose["orientation"] == pytest.approx(turn)
    check_parts(drawn.content, drawn.schema)


def test_a_pose_of_ros_has_the_frame_of_its_header() -> None:
    pose = {"position": {**ORIGIN, "z": 3.0}, "orientation": UPRIGHT}
    (drawn,) = drawings({"header": {"frame_id": "map"}, "pose": pose}, 0.0)
    assert (drawn.kind, drawn.part) == ("poses", "pose")
    assert (drawn.content["frame_id"], drawn.content["pose"]) == ("map", pose)


def test_transforms_are_drawn_each() -> None:
    of_ros = {
        "header": {"frame_id": "base"},
        "child_frame_id": "arm",
        "transform": {"translation": {**ORIGIN, "x": 1.0}, "rotation": UPRIGHT},
    }
    flat = {
        "parent_frame_id": "arm",
        "child_frame_id": "hand",
        "translation": ORIGIN,
        "rotation": UPRIGHT,
    }
    first, second = drawings({"transforms": [of_ros, flat]}, 0.0)
    for drawn, ends in (first, ("base", "arm")), (second, ("arm", "hand")):
        content = drawn.content
        assert (drawn.kind, drawn.part) == ("transforms", "transforms")
        assert (content["parent_frame_id"], content["child_frame_id"]) == ends
        check_parts(content, drawn.schema)
    assert first.content["translation"]["x"] == 1.0


def test_a_table_of_points_is_a_cloud() -> None:
    points = np.arange(12, dtype=np.float32).reshape(3, 4)
    (drawn,) = drawings({"frame_id": "laser", "points": points}, 0.0)
    assert (drawn.kind, drawn.part) == ("clouds", "points")
    assert drawn.content["frame_id"] == "laser"
    assert drawn.content["point_stride"] == 4 * 4  # four numbers of four bytes
    fields = [(f["name"], f["offset"], f["type"]) for f in drawn.content["fields"]]
    assert fields == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7)]
    data = base64.b64decode(drawn.content["data"])
    assert np.frombuffer(data, np.float32).tolist() == list(range(12))
    check_parts(drawn.content, drawn.schema)


def check_parts(content: Any, schema: Any) -> None:
    """Raise unless a schema names all that an object holds, and nothing else."""
    assert content.keys() == schema["properties"].keys()
    for name, part in schema["properties"].items():
        if part["type"] == "object":
            check_parts(content[name], part)
