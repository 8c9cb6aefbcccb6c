"""How a message is in a recording."""

from __future__ import annotations

import base64
import json

import msgspec
import numpy as np

from poise.manage.observe.chains import ChainReport
from poise.view.robot_recording import (
    MOST_LISTED,
    ChainRow,
    as_json,
    chain_row,
    schema_of,
)
from poise.wire.records.status_records import Summary


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


def test_a_chain_that_was_not_used_has_no_age() -> None:
    chain = ChainReport(
        name="sight", deadline=0.2, missed=0, age=Summary(), error=0.0, hops=()
    )
    assert chain_row(chain) == ChainRow("sight", None, None, 0.2, 0)
    # Foxglove refuses parts that may be null
    assert schema_of(ChainRow)["properties"]["p99"] == {"type": "number"}
