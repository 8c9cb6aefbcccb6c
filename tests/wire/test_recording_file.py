"""What a recording says that is damaged, or is another program's."""

from __future__ import annotations

import contextlib
from pathlib import Path
from random import Random

import pytest
from mcap.writer import Writer

from poise.errors import PoiseError, UsageError
from poise.wire.recording_file import Input, inputs_of, robot_of, said_in, samples_of
from tests.recordings import write_recording

INPUTS = [Input("a.x", float(at), b"said", b"") for at in range(9)]


def test_a_damaged_recording_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "it.mcap"
    write_recording(path, "r", INPUTS)
    path.write_bytes(path.read_bytes().replace(b"\x28\xb5\x2f\xfd", bytes(4)))
    with pytest.raises(UsageError, match=r"it\.mcap is damaged: ZstdError"):
        inputs_of(path)


def test_a_recording_of_which_one_bit_differs_is_not_read_as_another(
    tmp_path: Path,
) -> None:
    path = tmp_path / "it.mcap"
    write_recording(path, "r", INPUTS)
    read, whole = inputs_of(path), path.read_bytes()
    for at in range(whole.index(b"\x28\xb5\x2f\xfd"), len(whole), 5):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with contextlib.suppress(UsageError):
            assert inputs_of(path) == read


def test_nobody_else_can_read_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "it.mcap"
    write_recording(path, "r", INPUTS)
    assert path.stat().st_mode & 0o77 == 0


def test_whatever_a_file_holds_poise_says_it_by_its_own_errors(tmp_path: Path) -> None:
    path, random = tmp_path / "it.mcap", Random(7)
    write_recording(path, "r", INPUTS)
    whole = path.read_bytes()
    for _ in range(100):
        data = bytearray(whole)
        data[random.randrange(len(data))] = random.randrange(256)
        path.write_bytes(data)
        with contextlib.suppress(PoiseError):
            assert robot_of(path)
            assert not [*samples_of(path), *said_in(path)]
            inputs_of(path)


def test_a_recording_of_another_program_has_no_inputs(tmp_path: Path) -> None:
    path = tmp_path / "it.mcap"
    with path.open("wb") as file:
        other = Writer(file)
        other.start()
        channel = other.register_channel("scan", "json", 0)
        other.add_message(channel, 1, b"{}", 1)
        other.finish()
    assert inputs_of(path) == []
