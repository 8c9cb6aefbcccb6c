"""How a message is in a recording."""

from __future__ import annotations

import base64
import json

import msgspec
import numpy as np

from poise.view.robot_recording import MOST_LISTED, as_json


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


def test_complex_numbers_are_written_as_bytes() -> None:
    spectrum = np.array([1 + 2j, 3 - 4j])
    written = json.loads(msgspec.json.encode(as_json({"spectrum": spectrum})))
    data = base64.b64decode(written["spectrum"]["data"])
    assert np.frombuffer(data, written["spectrum"]["dtype"]).tolist() == [
        1 + 2j,
        3 - 4j,
    ]
