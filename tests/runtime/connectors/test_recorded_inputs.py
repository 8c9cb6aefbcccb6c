"""What comes over connectors is written to a file, and read again."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from poise import Message
from poise.runtime.component.ports import Port
from poise.runtime.connectors.latest import Numbered, numbered, numbered_tag
from poise.runtime.connectors.tap import InputFile
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections.connection_server import Handler
from poise.wire.frame import Frame, FrameKind
from poise.wire.recording_file import Input, inputs_of, stored_inputs
from tests.recordings import write_recording


class Vectors(Message):
    one: NDArray[np.uint8]
    two: NDArray[np.uint8]


@pytest.fixture(name="file")
def _file(tmp_path: Path) -> Iterator[InputFile]:
    port = Port("x", "subscribes", Vectors)
    file = InputFile(tmp_path / "it.inputs", "a.x", port)
    yield file
    file.close()


def inputs_so_far(tmp_path: Path) -> list[Input]:
    """Return what a run that was killed by now would have left."""
    (tmp_path / "it").unlink(missing_ok=True)
    write_recording(tmp_path / "it", "r")
    return inputs_of(tmp_path / "it")


def come(handler: Handler, kind: FrameKind, value: Any, tag: int = 7) -> None:
    type_: Any = type(value)
    pieces = frame.segments(codec(type_), value, kind, tag=tag)
    handler(frame.parse(b"".join(bytes(each) for each in pieces)))


def received(file: InputFile) -> tuple[Handler, list[Frame]]:
    """Return a handler that records, and what goes on to the one behind it."""
    frames: list[Frame] = []
    return file.handler(frames.append), frames


def test_messages_are_recorded_without_and_calls_with_a_tag(
    file: InputFile, tmp_path: Path
) -> None:
    handler, frames = received(file)
    come(handler, FrameKind.MESSAGE, "one")
    come(handler, FrameKind.MARKER, None)
    come(handler, FrameKind.ONEWAY, "two")
    assert [each.kind for each in frames] == [
        FrameKind.MESSAGE,
        FrameKind.MARKER,
        FrameKind.ONEWAY,
    ]
    found = inputs_so_far(tmp_path)
    assert [(each.source, each.tag) for each in found] == [("a.x", None), ("a.x", 7)]
    assert 0 == found[0].at <= found[1].at
    decode = codec(str).decode
    assert [decode(e.body, memoryview(e.buffers)) for e in found] == ["one", "two"]


def test_a_call_whose_callee_has_moved_is_recorded_only_where_it_runs(
    file: InputFile, tmp_path: Path
) -> None:
    """Its caller sends it to the new place, which records it, too."""
    handler = file.handler(lambda _: frame.segments(codec(str), "", FrameKind.MOVED))
    come(handler, FrameKind.CALL, "one")
    assert not inputs_so_far(tmp_path)


def test_last_messages_are_recorded_as_all_others(
    file: InputFile, tmp_path: Path
) -> None:
    coder, tag = numbered(codec(Vectors)), numbered_tag(Vectors)
    array = np.arange(3, dtype=np.uint8)
    value = Numbered((1, 2), True, Vectors(array, array))
    pieces = frame.segments(coder, value, FrameKind.MESSAGE, tag=tag)
    received(file)[0](frame.parse(b"".join(map(bytes, pieces))))
    (found,) = inputs_so_far(tmp_path)
    assert found.tag is None
    got = codec(Vectors).decode(found.body, memoryview(found.buffers))
    np.testing.assert_array_equal(got.two, array)


def test_what_is_no_numbered_message_is_refused_but_not_recorded(
    file: InputFile, tmp_path: Path
) -> None:
    """What raised here would end the thread of its connection."""
    handler, frames = received(file)
    come(handler, FrameKind.MESSAGE, "nothing of the kind", tag=numbered_tag(Vectors))
    assert len(frames) == 1
    assert not inputs_so_far(tmp_path)


def test_arrays_of_any_length_are_recorded(file: InputFile, tmp_path: Path) -> None:
    sent = Vectors(np.arange(3, dtype=np.uint8), np.arange(5, dtype=np.uint8))
    come(received(file)[0], FrameKind.MESSAGE, sent)
    (found,) = inputs_so_far(tmp_path)
    got = codec(Vectors).decode(found.body, memoryview(found.buffers))
    np.testing.assert_array_equal(got.one, sent.one)
    np.testing.assert_array_equal(got.two, sent.two)


def test_a_cut_off_end_is_left_out(file: InputFile, tmp_path: Path) -> None:
    handler, _ = received(file)
    come(handler, FrameKind.MESSAGE, "one")
    come(handler, FrameKind.MESSAGE, "two")
    (path,) = (tmp_path / "it.inputs").iterdir()
    path.write_bytes(path.read_bytes()[:-1])
    assert len(list(stored_inputs(path))) == 1


def test_a_recording_is_bounded_and_says_so(
    file: InputFile,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr("poise.runtime.connectors.tap.MOST_RECORDED", 100)
    handler, frames = received(file)
    for _ in range(5):
        come(handler, FrameKind.MESSAGE, "a" * 60)
    assert len(frames) == 5
    assert len(inputs_so_far(tmp_path)) == 1
    said = caplog.messages[0]
    assert "nothing more is recorded: the limit of 100 B is reached" in said


def test_what_comes_while_a_recording_is_closed_is_handled_as_ever(
    file: InputFile, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    handler, frames = received(file)
    come(handler, FrameKind.MESSAGE, "one")
    file.close()
    come(handler, FrameKind.MESSAGE, "two")
    assert len(frames) == 2
    assert len(inputs_so_far(tmp_path)) == 1
    assert caplog.messages[0].endswith(" is closed")


def test_a_full_disk_ends_a_recording_and_nothing_else(
    file: InputFile, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    handler, frames = received(file)
    come(handler, FrameKind.MESSAGE, "one")
    (path,) = (tmp_path / "it.inputs").iterdir()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size, before[1]))
    try:
        come(handler, FrameKind.MESSAGE, "two")
        file.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(frames) == 2
    assert len(inputs_so_far(tmp_path)) == 1
    assert "could not be ended" in caplog.text
