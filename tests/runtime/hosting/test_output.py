"""What components write is passed on, and kept within bounds."""

from __future__ import annotations

import errno
import logging
import os
import sys
import threading
from io import BytesIO, StringIO, TextIOWrapper
from pathlib import Path
from typing import Any, NoReturn
from unittest.mock import Mock

import pytest

from poise.clock import wall_time
from poise.runtime.hosting import output
from poise.runtime.hosting.output import (
    LONGEST,
    KeptStream,
    OutputFile,
    forget_output,
    keep_output,
    output_trouble,
    read_output,
    write_as,
)
from poise.wire.records.request_records import OutputLines, ReadOutput
from tests.waiting import LIMIT


@pytest.fixture(autouse=True)
def _no_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "_BEING_WRITTEN", 0)


def read(
    folder: Path, component: str = "", after: int = 0, most: int = 99
) -> OutputLines:
    return read_output(folder, ReadOutput(component=component, after=after, most=most))


def test_all_is_passed_on_and_whole_lines_are_kept(tmp_path: Path) -> None:
    terminal = StringIO()
    stream = KeptStream(terminal, OutputFile(tmp_path, "hall"))
    print("one", 2, file=stream)
    stream.write("half")
    assert terminal.getvalue() == "one 2\nhalf"
    assert [(o.component, o.text) for o in read(tmp_path).lines] == [("hall", "one 2")]
    stream.write(" and half\n\n")
    assert [o.text for o in read(tmp_path).lines] == ["one 2", "half and half", ""]


def test_code_uses_the_stream_as_it_does_elsewhere(tmp_path: Path) -> None:
    terminal = TextIOWrapper(BytesIO(), encoding="utf-8")
    stream: Any = KeptStream(terminal, OutputFile(tmp_path, "hall"))
    assert (stream.encoding, stream.errors) == ("utf-8", "strict")
    assert stream.writable()
    stream.reconfigure(write_through=True)
    stream.write("text, ")
    stream.buffer.write(b"and bytes")
    assert terminal.buffer.getvalue() == b"text, and bytes"


def test_lines_are_those_of_the_component_whose_thread_writes(tmp_path: Path) -> None:
    stream = KeptStream(StringIO(), OutputFile(tmp_path, "hall"))

    def work(name: str) -> None:
        write_as(name)
        stream.write(f"I am {name}")
        stream.write("\n")

    for name in ("eye", "ear"):
        thread = threading.Thread(target=work, args=(name,))
        thread.start()
        thread.join()
    assert [o.text for o in read(tmp_path, "ear").lines] == ["I am ear"]
    assert [o.component for o in read(tmp_path).lines] == ["eye", "ear"]


def test_what_a_call_writes_is_its_callees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = KeptStream(StringIO(), OutputFile(tmp_path, "hall"))
    monkeypatch.setattr(output, "called", lambda: "ear")
    stream.write("I am the ear\n")
    assert [o.component for o in read(tmp_path).lines] == ["ear"]


def test_who_asks_again_gets_what_is_new(tmp_path: Path) -> None:
    file = OutputFile(tmp_path, "hall")
    for number in range(5):
        file.add(str(number))
    first = read(tmp_path, most=2)
    assert ([o.text for o in first.lines], first.omitted) == (["3", "4"], 3)
    file.add("5")
    again = read(tmp_path, after=first.lines[-1].at)
    assert ([o.text for o in again.lines], again.omitted) == (["5"], 0)
    none = read(tmp_path, most=0)
    assert (none.lines, none.omitted) == ((), 6)


def test_what_is_being_written_is_told_the_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    OutputFile(tmp_path, "hall").add("now")
    monkeypatch.setattr(output, "_BEING_WRITTEN", 10**12)
    assert read(tmp_path).lines == ()


def test_files_stay_small_and_long_lines_are_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output, "LARGEST", 1_000)
    file = OutputFile(tmp_path, "hall")
    for number in range(200):
        file.add(f"line {number}")
    file.add("x" * 2 * LONGEST)
    kept = [o.text for o in read(tmp_path).lines]
    assert kept[-2:] == ["line 199", "x" * LONGEST]
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) < 2_000 + 2 * LONGEST
    assert len(list(tmp_path.iterdir())) == 2
    forget_output(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_container_that_starts_again_goes_on_in_its_file(tmp_path: Path) -> None:
    OutputFile(tmp_path, "hall").add("last words")
    OutputFile(tmp_path, "hall").add("born again")
    assert [o.text for o in read(tmp_path).lines] == ["last words", "born again"]


def test_a_component_goes_on_when_the_disk_is_full(tmp_path: Path) -> None:
    file = OutputFile(tmp_path, "hall")
    file._fd = os.open("/dev/full", os.O_WRONLY)
    terminal = StringIO()
    stream = KeptStream(terminal, file)
    print("still here", file=stream)
    print("and here", file=stream)
    assert terminal.getvalue() == "still here\nand here\n"
    assert "writes is not kept: [Errno 28] No space left" in stream.trouble()


@pytest.mark.parametrize("starts_again", [False, True])
def test_a_line_that_a_full_disk_cuts_short_spoils_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, starts_again: bool
) -> None:
    file, write = OutputFile(tmp_path, "hall"), os.write
    file.add("before")
    monkeypatch.setattr(os, "write", lambda fd, data: write(fd, data[:5]))
    file.add("cut short")
    monkeypatch.undo()
    monkeypatch.setattr(output, "_BEING_WRITTEN", 0)
    assert "No space left on device" in file.trouble()
    again = OutputFile(tmp_path, "hall") if starts_again else file
    again.add("after")
    assert [line.text for line in read(tmp_path).lines] == ["before", "after"]
    assert all(line.at < 2**63 for line in read(tmp_path).lines)


def test_a_component_goes_on_when_the_disk_of_its_agents_log_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> NoReturn:
        raise OSError(errno.ENOSPC, "No space left on device")

    log = Mock(write=fail, flush=fail)
    stream = KeptStream(log, OutputFile(tmp_path, "hall"))
    monkeypatch.setattr(sys, "stdout", stream)
    assert output_trouble() == ""
    print("still here", file=stream, flush=True)
    print("and here", file=stream)
    assert [o.text for o in read(tmp_path).lines] == ["still here", "and here"]
    assert output_trouble() == (
        "what container 'hall' writes is not in the agent's log: "
        "[Errno 28] No space left on device"
    )
    monkeypatch.setattr(output, "SHOWN_FOR", -1.0)
    assert output_trouble() == ""


@pytest.mark.parametrize("failing", ["open", "rename"])
def test_a_file_that_cannot_be_followed_by_another_writes_to_none_of_a_component(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    failing: str,
) -> None:
    monkeypatch.setattr(output, "LARGEST", 100)
    file = OutputFile(tmp_path, "hall")
    file.add("before")

    def fail(*_: object) -> NoReturn:
        raise OSError(errno.EMFILE, "no descriptor is free")

    with monkeypatch.context() as patch:
        patch.setattr(os, failing, fail)
        file.add("x" * 100)
    its_own = tmp_path / "of the component"
    with its_own.open("wb", buffering=0) as component:  # it gets the first free number
        file.add("after")
        component.write(b"mine")
    assert its_own.read_bytes() == b"mine"
    assert "after" in [o.text for o in read(tmp_path).lines]
    assert "no descriptor is free" in file.trouble()


def test_a_file_that_somebody_removed_is_begun_again_when_it_would_be_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output, "LARGEST", 100)
    file = OutputFile(tmp_path, "hall")
    file.add("before")
    forget_output(tmp_path)
    file.add("x" * 100)
    file.add("after")
    assert [o.text for o in read(tmp_path).lines] == ["after"]
    assert not file.trouble()


def test_what_a_destructor_writes_while_a_line_is_kept_holds_nobody_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python runs those of cycles at any moment, on whatever thread."""
    file = OutputFile(tmp_path, "hall")

    class Leaving:
        def __del__(self) -> None:
            file.add("goodbye")

    left = [Leaving()]

    def now() -> float:
        left.clear()
        return wall_time()

    monkeypatch.setattr(output, "wall_time", now)
    writing = threading.Thread(target=file.add, args=("hello",), daemon=True)
    writing.start()
    writing.join(LIMIT)
    assert {o.text for o in read(tmp_path).lines} == {"hello", "goodbye"}


def test_moments_grow_even_when_the_clock_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output, "wall_time", lambda: 7e-9)
    file = OutputFile(tmp_path, "hall")
    file.add("a")
    file.add("b")
    monkeypatch.undo()
    monkeypatch.setattr(output, "_BEING_WRITTEN", 0)
    assert [o.at for o in read(tmp_path).lines] == [7, 8]


def test_all_is_told_though_the_clock_was_set_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, now = OutputFile(tmp_path, "hall"), wall_time()
    monkeypatch.setattr(output, "wall_time", lambda: now + 3600.0)
    file.add("before")
    monkeypatch.setattr(output, "wall_time", lambda: now)
    first = read(tmp_path)
    assert [line.text for line in first.lines] == ["before"]
    file.add("after")
    again = read(tmp_path, after=first.lines[-1].at)
    assert [line.text for line in again.lines] == ["after"]


def test_a_container_that_starts_again_goes_on_though_the_clock_was_set_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = wall_time()
    monkeypatch.setattr(output, "wall_time", lambda: now + 3600.0)
    OutputFile(tmp_path, "hall").add("last words")
    monkeypatch.setattr(output, "wall_time", lambda: now)
    OutputFile(tmp_path, "hall").add("x" * LONGEST)
    first = read(tmp_path)
    assert [line.text for line in first.lines] == ["last words", "x" * LONGEST]
    OutputFile(tmp_path, "hall").add("born again")
    again = read(tmp_path, after=first.lines[-1].at)
    assert [line.text for line in again.lines] == ["born again"]


def test_what_is_logged_is_kept_without_its_time_and_passed_on_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = StringIO()
    handler = logging.StreamHandler(terminal)
    handler.setFormatter(logging.Formatter("12:00 %(message)s"))
    monkeypatch.setattr(logging.getLogger(), "handlers", [handler])
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, StringIO())
    keep_output(tmp_path, "hall")
    logging.getLogger("eye").warning("it is\nhot")
    assert [o.text for o in read(tmp_path).lines] == ["WARNING eye: it is", "hot"]
    assert terminal.getvalue() == "12:00 it is\nhot\n"
    # as in `restore`, which another thread runs
    logging.getLogger("poise.component.ear").warning("it is loud")
    assert [o.text for o in read(tmp_path, "ear").lines] == [
        "WARNING poise.component.ear: it is loud"
    ]
