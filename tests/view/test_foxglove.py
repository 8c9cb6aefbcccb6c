"""What Foxglove draws of a message."""

from __future__ import annotations

from math import inf, pi
from typing import Any

import numpy as np
import pytest

from poise.view.foxglove import FoxglovePart, drawings
from tests.protobuf import plain

HALF = 0.5**0.5
ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}
UPRIGHT = {**ORIGIN, "w": 1.0}


def test_pictures_are_found_wherever_they_are() -> None:
    colours = np.zeros((10, 20, 3), np.uint8)
    jpeg = b"\xff\xd8\xff\xe0 and so on"
    message = {"left": {"pixels": colours}, "file": jpeg, "matrix": np.eye(3)}
    picture, file = drawings(message, 1.5)
    assert (picture.part, picture.name) == ("left/pixels", "RawImage")
    raw = read(picture)
    size = {"width": 20, "height": 10, "step": 60, "encoding": "rgb8"}
    assert raw.items() >= size.items()
    assert raw["timestamp"] == {"seconds": 1, "nanos": 500_000_000}
    assert len(raw["data"]) == colours.nbytes
    assert (file.part, file.name) == ("file", "CompressedImage")
    compressed = read(file)
    assert (compressed["format"], compressed["data"]) == ("jpeg", jpeg)


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
        {"x": 1.0, "y": 2.0, "heading": inf},
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
    read(drawn)


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
        read(drawn)
    assert first.content["translation"]["x"] == 1.0


def test_a_table_of_points_is_a_cloud() -> None:
    points = np.arange(12, dtype=np.float32).reshape(3, 4)
    (drawn,) = drawings({"frame_id": "laser", "points": points}, 0.0)
    assert (drawn.kind, drawn.part) == ("clouds", "points")
    assert drawn.content["frame_id"] == "laser"
    assert drawn.content["point_stride"] == 4 * 4  # four numbers of four bytes
    fields = [(f["name"], f["offset"], f["type"]) for f in drawn.content["fields"]]
    assert fields == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7)]
    data = drawn.content["data"]
    assert np.frombuffer(data, np.float32).tolist() == list(range(12))
    read(drawn)


def read(drawn: FoxglovePart) -> dict[str, Any]:
    """Return what a viewer reads of a drawing, which is all that it holds."""
    found = plain(drawn.type(**drawn.content))
    assert found == drawn.content
    return found
