"""Incarnations that worked at the same time, in logs that were written by hand."""

from __future__ import annotations

import os
import runpy
import shutil
import tempfile
from pathlib import Path

from examples.demo.overlaps import Overlap, overlaps, read_handler_log

WRITER = Path(__file__).parents[2] / "examples/relay/handler_log.py"


def found(folder: Path, **logs: str) -> list[Overlap]:
    """Return the overlaps; a log has runs of a handler as "begin-on-...-end".

    The even processes are on 'a', the others on 'b'.
    """
    for name, runs in logs.items():
        component, process = name.split("_")
        lines = []
        for run in runs.split():
            begin, *rest = run.split("-")
            on, end = rest[:-1], rest[-1:]
            lines += [f"begin {begin}", *(f"on {m}" for m in on)]
            lines += [f"end {m}" for m in end]
        text = "".join(f"{line}\n" for line in lines)
        computer = "ab"[int(process) % 2]
        (folder / f"{component}.{computer}.{process}.any").write_text(text)
    return overlaps(read_handler_log(folder))


def test_one_after_the_other_is_no_overlap(tmp_path: Path) -> None:
    assert found(tmp_path, relay_7="1-2 3-4", relay_8="4-5 6-7", sink_7="1-7") == []


def test_handlers_that_the_older_one_begins_beside_the_newer_one(
    tmp_path: Path,
) -> None:
    # 8 works from 4 to 9; meanwhile 7 begins at 5 and at 7, and ends at 7.5
    (overlap,) = found(tmp_path, relay_8="4-4.5 8-9", relay_7="1-2 5-6 7-7.5")
    assert overlap == Overlap(
        component="relay",
        computers=("b", "a"),
        processes=(7, 8),
        since=5,
        until=7.5,
        begun=2,
        went_on=0,
    )
    assert str(overlap).startswith("'relay' worked twice from 5.000 s to 7.500 s")


def test_a_handler_that_goes_on_beside_the_newer_one(tmp_path: Path) -> None:
    # 7 began at 1, before 8 did at 2; it was at work at 2.5 and ended at 4
    (overlap,) = found(tmp_path, relay_7="1-1.5-2.5-4", relay_8="2-3 5-6")
    assert (overlap.begun, overlap.went_on) == (0, 1.5)
    assert (overlap.since, overlap.until) == (2.5, 4)


def test_a_handler_that_was_stopped_meanwhile_did_not_work(tmp_path: Path) -> None:
    # killed while it stood still: it was last at work at 1.5
    assert found(tmp_path, relay_7="1-1.5", relay_8="2-3") == []
    # it went on at 9, when the newer one had ended, too
    assert found(tmp_path, relay_7="1-1.5-9", relay_8="2-3") == []


def test_an_older_one_that_works_again_after_the_newer_one_is_no_overlap(
    tmp_path: Path,
) -> None:
    assert found(tmp_path, relay_7="1-2 6-7", relay_8="3-4") == []


def test_each_pair_counts(tmp_path: Path) -> None:
    # 7 with 8, 7 with 9, and 8 with 9
    three = found(tmp_path, relay_7="1-2 6-7", relay_8="3-4 5-8", relay_9="4.5-9")
    assert [each.processes for each in three] == [(8, 9), (7, 8), (7, 9)]


def test_incarnations_in_one_process_are_two(tmp_path: Path) -> None:
    (tmp_path / "relay.a.7.first").write_text("begin 1\nend 4\n")
    (tmp_path / "relay.a.7.second").write_text("begin 2\nend 3\nbegin 5\nend 6\n")
    (overlap,) = overlaps(read_handler_log(tmp_path))
    assert overlap.processes == (7, 7)


def test_what_a_killed_process_had_not_finished_does_not_count(tmp_path: Path) -> None:
    (tmp_path / "relay.a.7.any").write_text("begin 1\nend 2\nbeg")
    (tmp_path / "relay.a.8.any").write_text("")
    (log,) = read_handler_log(tmp_path)
    assert [run.moments for run in log.runs] == [(1, 2)]


def test_reads_what_components_write(tmp_path: Path) -> None:
    (tmp_path / "handler-log").mkdir()
    writer = runpy.run_path(str(shutil.copy(WRITER, tmp_path)))
    handlers = writer["HandlerLog"]("relay")
    with handlers.run():
        handlers.go_on()
    with handlers.run():
        pass
    (log,) = read_handler_log(tmp_path / "handler-log")
    assert (log.component, log.process) == ("relay", os.getpid())
    assert log.computer == Path(tempfile.gettempdir()).name
    assert [len(run.moments) for run in log.runs] == [3, 2]
    assert log.runs[0].begin <= log.runs[0].end <= log.runs[1].begin


def test_components_log_nothing_in_the_folder_of_an_example(tmp_path: Path) -> None:
    writer = runpy.run_path(str(shutil.copy(WRITER, tmp_path)))
    with writer["HandlerLog"]("relay").run():
        pass
    assert [file.name for file in tmp_path.iterdir()] == ["handler_log.py"]
