"""A file for Foxglove, read back with the library of its format."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from msgspec import Struct

from poise.errors import RunError, UsageError
from poise.view.robot_recording import schema_like, schema_of
from poise.wire.recording_file import McapFile, extra
from tests.protobuf import decoded

reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")


class EyeRow(Struct, frozen=True):
    name: str
    cpu: float


def read(path: Path) -> list[tuple[str, str, int, Any]]:
    """Return topic, schema, time [ns] and value of all messages, which are valid."""
    found = []
    with path.open("rb") as file:
        whole = reader.make_reader(file)
        assert whole.get_summary() is not None
        for schema, channel, message in whole.iter_messages():
            encodings = (schema.encoding, channel.message_encoding)
            if encodings == ("protobuf", "protobuf"):
                value = decoded(schema.data, schema.name, message.data)
            else:
                assert encodings == ("jsonschema", "json")
                value = json.loads(message.data)
                check_json(json.loads(schema.data), value)
            found.append((channel.topic, schema.name, message.log_time, value))
    return found


def check_json(rule: Any, value: Any) -> None:
    """Raise unless a value fits a schema that Foxglove takes."""
    jsonschema.Draft202012Validator.check_schema(rule)
    jsonschema.validate(value, rule)
    check_for_foxglove(rule)


def check_for_foxglove(schema: Any) -> None:
    """Raise unless Foxglove takes a schema: it refuses topics with any other."""
    assert schema["type"] == "object"
    for part in schema["properties"].values():
        each = part["items"] if part["type"] == "array" else part
        if each["type"] == "object":
            check_for_foxglove(each)
        else:
            assert each["type"] in {"boolean", "string", "number", "integer"}


def test_records_and_values_come_back(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    message = {
        "pose": [1.0, 2],
        "ok": True,
        "left": None,
        "name": "x",
        "more": [],
        "mixed": [1, "b"],
        "matrix": [[1, 2], [3, 4]],
        "parts": [{"at": 1, "seen": None}, {"at": 2, "seen": 3}],
        "empty": {},
    }
    with McapFile(path, "r") as file:
        schema = schema_of(EyeRow)
        file.add("eyes.left", schema, 1.5, EyeRow("left", 0.25))
        file.add("said", schema_like(message, "Pose"), 2.0, message)
    assert read(path) == [
        ("/eyes/left", "poise.Eye", 1_500_000_000, {"name": "left", "cpu": 0.25}),
        ("/said", "Pose", 2_000_000_000, message),
    ]
    assert file.summary() == "2 messages of 2 topics"


def test_what_an_error_ends_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"

    def write() -> None:
        with McapFile(path, "r") as file:
            file.add("eye", schema_of(EyeRow), 1.0, EyeRow("eye", 0.5))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert len(read(path)) == 1


def test_a_full_disk_is_told_and_the_file_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    with McapFile(path, "r") as file:
        file.add("eye", schema_of(EyeRow), 1.0, EyeRow("eye", 0.5))
        full = os.statvfs_result((4096, 4096, 100, 0, 1000, 9, 9, 9, 0, 255))
        monkeypatch.setattr(os, "fstatvfs", lambda _: full)
        with pytest.raises(RunError, match=r"disk is full: 3\.91 MiB are left"):
            file.add("eye", schema_of(EyeRow), 2.0, EyeRow("eye", 0.5))
    assert len(read(path)) == 1
    with pytest.raises(UsageError, match="disk is full"):
        McapFile(tmp_path / "b.mcap", "r")
    assert not (tmp_path / "b.mcap").exists()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("mine")
    with pytest.raises(UsageError, match="cannot be created: File exists"):
        McapFile(tmp_path / "a.mcap", "r")


def test_a_library_that_is_not_installed_is_named_with_its_extra() -> None:
    with pytest.raises(
        UsageError, match=r"needs absent: pip install 'poise\[record\]'"
    ):
        extra("absent.writer")
