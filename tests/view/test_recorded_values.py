"""How a message is in a recording."""

from __future__ import annotations

import base64
import json
from math import inf, nan
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from poise.view.robot_recording import MOST_LISTED, as_json, schema_of
from poise.view.robot_view import ChainRow
from poise.wire.codec import pack, unpack
from poise.wire.recording_file import MESSAGES, McapFile, said_in


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


@pytest.mark.parametrize(
    ("value", "type_"),
    [
        (np.array([1.0, np.inf, -np.inf, np.nan], np.float32), NDArray[np.float32]),
        (np.zeros((0, 3)), NDArray[np.float64]),
        (np.array([b"raw"]), NDArray[np.bytes_]),
        (np.array(["2026-11-30"], "M8[ns]"), NDArray[np.datetime64]),
        ([-inf, nan, 1.0], list[float]),
    ],
)
def test_what_is_recorded_is_played_as_it_was(
    value: Any, type_: Any, tmp_path: Path
) -> None:
    with McapFile(tmp_path / "it.mcap", "robot") as file:
        file.add(f"{MESSAGES}/eye.seen-mind.seen", None, 1.0, as_json({"it": value}))
    (said,) = said_in(tmp_path / "it.mcap")
    played = unpack(pack(said.value["it"]), type_)
    np.testing.assert_equal(played, value)
    assert getattr(played, "dtype", None) == getattr(value, "dtype", None)
    assert np.shape(played) == np.shape(value)


def test_what_is_not_known_of_a_row_is_left_out() -> None:
    """Foxglove refuses parts that may be null."""
    assert schema_of(ChainRow)["properties"]["p99"] == {"type": "number"}
