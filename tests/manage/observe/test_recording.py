"""A recording grows on the disk while it is made, and not in memory."""

from __future__ import annotations

import logging
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.manage.observe import sample_recording
from poise.manage.observe.sample_recording import Recording, RecordingFile
from poise.wire.recording_file import McapFile, robot_of, samples_of
from poise.wire.records.status_records import (
    AgentSample,
    ComponentSample,
    ContainerSample,
)
from tests.waiting import wait_until


def sample(at: float) -> AgentSample:
    parts = tuple(ComponentSample(f"c{n}", 0, at, 0.0, 1, 1) for n in range(10))
    return AgentSample("a", at, 0.0, (ContainerSample("x", 1, at, at, 1, parts, ()),))


def test_what_came_is_in_the_file(tmp_path: Path) -> None:
    recorder = RecordingFile(tmp_path / "it", "r")
    for number in range(3):
        recorder.add(sample(number))
    recorder.close()
    assert robot_of(tmp_path / "it") == "r"
    samples = list(samples_of(tmp_path / "it"))
    assert samples == [sample(number) for number in range(3)]
    assert str(recorder) == f"recorded 3 samples to {tmp_path / 'it'}"


def test_a_recording_that_was_there_is_replaced(tmp_path: Path) -> None:
    for robot in ("one", "two"):
        RecordingFile(tmp_path / "it", robot).close()
    assert robot_of(tmp_path / "it") == "two"


@pytest.mark.slow
def test_200_000_samples_take_no_memory_and_each_is_written_or_counted(
    tmp_path: Path,
) -> None:
    recorder = RecordingFile(tmp_path / "it", "r")
    recorder.add(sample(0))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number in range(1, 200_000):
        recorder.add(sample(number))
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    recorder.close()
    assert grown < 100_000  # KiB: three times what may wait for the disk
    kept = sum(1 for _ in samples_of(tmp_path / "it"))
    assert kept == recorder.count
    assert kept + recorder.missing == 200_000


_KILLED = """
import sys, time
from pathlib import Path
from poise.manage.observe.sample_recording import RecordingFile
from tests.manage.observe.test_recording import sample
recorder = RecordingFile(Path(sys.argv[1]), "r")
number = 0
while True:
    recorder.add(sample(number))
    number += 1
    time.sleep(1e-4)
"""


@pytest.mark.slow
def test_it_can_be_read_after_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "it"
    root = Path(__file__).parents[3]
    with subprocess.Popen([sys.executable, "-c", _KILLED, str(path)], cwd=root) as made:
        wait_until(lambda: path.exists() and path.stat().st_size > 20_000)
        made.send_signal(signal.SIGKILL)
    kept = list(samples_of(path))
    assert [each.at for each in kept] == list(range(len(kept)))
    assert len(kept) > 10


@pytest.mark.parametrize("cut", [1, 3, 50])
def test_half_a_record_at_the_end_is_left_out_and_said(
    tmp_path: Path, cut: int, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "it"
    with McapFile(path, "r", at_once=True) as file:
        file.add_record(sample(0), 1.0)
        one = path.stat().st_size
        file.add_record(sample(1), 2.0)
        assert path.stat().st_size > one
    os.truncate(path, one + cut)
    with caplog.at_level(logging.WARNING):
        assert list(samples_of(path)) == [sample(0)]
    assert "was not closed: its end is missing" in caplog.text


def test_a_recording_that_is_not_there_is_named_once(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as said:
        list(samples_of(tmp_path / "none.mcap"))
    path = tmp_path / "none.mcap"
    assert str(said.value) == (
        f"recording {path} cannot be read: No such file or directory"
    )


def test_a_full_disk_costs_records_and_not_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = RecordingFile(tmp_path / "it", "r")
    full = os.statvfs_result((4096, 4096, 100, 0, 1000, 9, 9, 9, 0, 255))
    monkeypatch.setattr(os, "fstatvfs", lambda _: full)
    for number in range(5):
        recorder.add(sample(number))
    recorder.close()
    assert recorder.missing == 5
    assert recorder.trouble.startswith(
        f"the recording {tmp_path / 'it'} cannot be written: the disk is full: "
    )
    assert str(recorder).startswith("recorded 0 samples to ")
    assert str(recorder).endswith("lacks 5 records")
    assert not list(samples_of(tmp_path / "it"))


def test_where_none_can_be_written_is_an_error_before_the_robot_starts(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError, match="cannot be created: No such file"):
        RecordingFile(tmp_path / "nowhere" / "it", "r")


def test_of_too_many_samples_the_last_wait_and_it_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sample_recording, "MOST", 2)
    waiting = Recording()
    for number in range(5):
        waiting.add(sample(number))
    assert [each.at for each in waiting.drain()] == [3, 4]
    assert waiting.drain() == []
    assert waiting.trouble == (
        "3 samples of agents arrived while the manager was busy, and were dropped"
    )
