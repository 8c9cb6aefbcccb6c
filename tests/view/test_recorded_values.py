"""What of a message is in a recording."""

from __future__ import annotations

import base64
import json

import msgspec
import numpy as np

from poise.view.robot_recording import MOST_LISTED, as_json, pictures


def test_all_of_a_message_is_written() -> None:
    scan = np.arange(MOST_LISTED + 1, dtype=np.float32)
    message = {
        "pose": (1.0, 2.0),
        "matrix": np.eye(2),
        "scan": scan,
        "raw": b"\x00\xff",
    }
    written = json.loads(msgspec.json.encode(as_json(message)))
    assert written["pose"] == [1.0, 2.0]
    assert written["matrix"] == [[1.0, 0.0], [0.0, 1.0]]
    assert base64.b64decode(written["raw"]) == b"\x00\xff"
    assert written["scan"]["shape"] == [MOST_LISTED + 1]
    data = base64.b64decode(written["scan"]["data"])
    assert np.frombuffer(data, written["scan"]["dtype"]).tolist() == scan.tolist()


def test_pictures_are_found_wherever_they_are() -> None:
    colours = np.zeros((10, 20, 3), np.uint8)
    jpeg = b"\xff\xd8\xff\xe0 and so on"
    message = {"left": {"pixels": colours}, "file": jpeg, "matrix": np.eye(3)}
    (name, schema, raw), (file, of_file, compressed) = pictures(message, 1.5)
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


def test_what_is_no_picture_is_left_alone() -> None:
    for value in (
        np.eye(9),  # of doubles
        np.zeros((7, 20), np.uint8),
        np.zeros((9, 9, 2), np.uint8),
        np.zeros(100, np.uint8),
        b"GIF or other",
        "text",
    ):
        assert list(pictures({"value": value}, 0.0)) == []
