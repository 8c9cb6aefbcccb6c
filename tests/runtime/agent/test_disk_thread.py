"""The folder of an agent, on a disk that does not answer."""

from __future__ import annotations

import resource
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec import structs

from poise.runtime.agent.agent_files import AgentFolder, CheckpointFiles, DiskThread
from poise.runtime.agent.surroundings import AgentState
from poise.testing import VirtualClock
from poise.wire.records.deployment_records import (
    ComponentSpec,
    ContainerSpec,
    Deployment,
)
from poise.wire.records.request_records import (
    Accepted,
    Answer,
    CheckpointCopy,
    Refused,
    checkpoint_path,
    set_age,
)
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

COPY = CheckpointCopy(component="map", epoch=1, data=b"state", age=7.0)
MAP = ComponentSpec(
    name="map", goal="active", implementation="m:Map", epoch=1, checkpoint=1.0
)
WANTED = Deployment(
    generation=1,
    containers=(
        ContainerSpec(name="see", folder="", components=(MAP,), connectors=()),
    ),
)


class Stalled:
    """A folder on a disk that answers when `answers` is set."""

    def __init__(
        self, path: Path, monkeypatch: pytest.MonkeyPatch, sent: list[CheckpointCopy]
    ) -> None:
        self.clock = VirtualClock(100.0)
        self.answers, self.is_asked = threading.Event(), threading.Event()
        self.folder = AgentFolder(path)
        keep = self.folder.keep

        def wait_and_keep(state: AgentState) -> None:
            self.is_asked.set()
            assert self.answers.wait(20.0)
            keep(state)

        monkeypatch.setattr(self.folder, "keep", wait_and_keep)
        files = CheckpointFiles(path, sent.append)
        self.disk = DiskThread(self.folder, files, self.clock)
        self.disk.start()


@pytest.fixture
def sent() -> list[CheckpointCopy]:
    return []


@pytest.fixture
def stalled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sent: list[CheckpointCopy]
) -> Iterator[Stalled]:
    stalled = Stalled(tmp_path, monkeypatch, sent)
    yield stalled
    stalled.answers.set()
    stalled.disk.stop()


def test_nobody_waits_for_the_disk_and_the_trouble_is_said(stalled: Stalled) -> None:
    disk, answers = stalled.disk, list[Answer]()
    disk.keep(AgentState(token=1))
    assert stalled.is_asked.wait(20.0)
    for token in range(2, 300):  # the last one counts
        disk.keep(AgentState(token=token))
    disk.serve(COPY, answers.append)
    stalled.clock.sleep(5.0)
    assert "has not answered for 5 s" in disk.trouble()
    assert not answers
    stalled.answers.set()
    wait_until(lambda: answers)
    assert answers == [Accepted()]
    wait_until(lambda: not disk.trouble())
    assert stalled.folder.left().token == 299


def test_requests_that_wait_for_the_disk_are_bounded(stalled: Stalled) -> None:
    answers: list[Answer] = []
    stalled.disk.keep(AgentState(token=1))
    assert stalled.is_asked.wait(20.0)
    for _ in range(150):
        stalled.disk.serve(COPY, answers.append)
    assert len(answers) == 50  # 100 wait
    assert isinstance(answers[0], Refused)
    assert "its disk is too slow" in answers[0].reason


def test_a_checkpoint_is_as_old_as_it_was_and_is_sent(
    stalled: Stalled, sent: list[CheckpointCopy]
) -> None:
    stalled.answers.set()
    answers: list[Answer] = []
    stalled.disk.serve(COPY, answers.append)
    stalled.disk.keep_only(WANTED)
    wait_until(lambda: sent)
    assert sent[0].data == b"state"
    assert 7.0 <= sent[0].age < 30.0
    age = stalled.disk.checkpoint_age("map", 1)
    assert age is not None
    assert 7.0 <= age < 30.0
    assert stalled.disk.checkpoint_age("map", 2) is None


def test_only_the_checkpoints_of_what_ended_are_removed(
    stalled: Stalled, tmp_path: Path
) -> None:
    stalled.answers.set()
    for component, epoch in [("map", 1), ("map", 2), ("plan", 1)]:
        checkpoint_path(tmp_path, component, epoch).write_bytes(b"state")
    stalled.disk.remove_checkpoints({("map", 1), ("gone", 4)})
    wait_until(lambda: not checkpoint_path(tmp_path, "map", 1).exists())
    assert checkpoint_path(tmp_path, "map", 2).exists()
    assert checkpoint_path(tmp_path, "plan", 1).exists()


def test_nobody_else_can_read_what_an_agent_keeps(tmp_path: Path) -> None:
    """Whoever made the folder may have let others into it."""
    folder = AgentFolder(tmp_path)
    folder.keep(AgentState(wanted=WANTED))
    CheckpointFiles(tmp_path, lambda _: None).write(COPY)
    kept = [path for path in tmp_path.iterdir() if path.is_file()]
    assert len(kept) == 3
    assert not any(path.stat().st_mode & 0o77 for path in kept)


def test_a_checkpoint_that_has_no_room_is_not_there_in_part(tmp_path: Path) -> None:
    files = CheckpointFiles(tmp_path, lambda _: None)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(b"sta"), before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            files.write(COPY)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not [*tmp_path.iterdir()]


def test_another_manager_gets_what_was_sent_to_the_one_before(tmp_path: Path) -> None:
    begun, goes_on = threading.Event(), threading.Event()
    sent: list[CheckpointCopy] = []

    def send(copy: CheckpointCopy) -> None:
        begun.set()  # the manager before does not take it
        assert goes_on.wait(20.0)
        sent.append(copy)

    files = CheckpointFiles(tmp_path, send)
    files.write(COPY)
    files.start()
    files.send_only(WANTED)
    assert begun.wait(20.0)
    files.resend()
    goes_on.set()
    wait_until(lambda: len(sent) == 2)
    assert [copy.data for copy in sent] == [b"state", b"state"]
    files.stop()


def test_a_new_state_is_sent_whatever_number_its_file_gets(tmp_path: Path) -> None:
    """A disk gives a new file the number of one that is gone: of the last but one."""
    goes_on = threading.Semaphore(0)
    sent: list[CheckpointCopy] = []

    def send(copy: CheckpointCopy) -> None:
        sent.append(copy)
        assert goes_on.acquire(timeout=20.0)

    files = CheckpointFiles(tmp_path, send)
    files.write(COPY)
    files.start()
    files.send_only(WANTED)
    wait_until(lambda: sent)
    for state in (b"second", b"third"):  # while the first is under way
        files.write(structs.replace(COPY, data=state, age=0.0))
    goes_on.release()
    wait_until(lambda: len(sent) == 2)
    goes_on.release()
    assert [copy.data for copy in sent] == [b"state", b"third"]
    files.stop()


def test_of_a_state_that_is_the_same_only_the_age_is_sent(tmp_path: Path) -> None:
    sent: list[CheckpointCopy] = []
    files = CheckpointFiles(tmp_path, sent.append)
    files.write(COPY)
    files.start()
    files.send_only(WANTED)
    wait_until(lambda: sent)
    (path,) = tmp_path.iterdir()
    set_age(path, 3.0)
    wait_until(lambda: len(sent) == 2)
    assert [copy.data for copy in sent] == [b"state", None]
    assert sent[1].age < COPY.age
    files.stop()


def test_what_is_forgotten_is_gone_when_it_stops(
    stalled: Stalled, tmp_path: Path
) -> None:
    answers: list[Answer] = []
    stalled.answers.set()
    stalled.disk.keep(AgentState(token=1))
    stalled.disk.serve(COPY, answers.append)
    stalled.disk.forget()
    stalled.disk.stop()
    assert answers == [Accepted()]
    assert {path.name for path in tmp_path.iterdir()} == {"lock"}


def test_a_folder_that_cannot_be_used_is_said(stalled: Stalled, tmp_path: Path) -> None:
    stalled.answers.set()
    (tmp_path / "state.new").mkdir()
    stalled.disk.keep(AgentState(token=1))
    wait_until(lambda: "cannot save its deployment" in stalled.disk.trouble())
    (tmp_path / "state.new").rmdir()

    def is_mended() -> bool:
        stalled.disk.keep(AgentState(token=1))  # as at each tick
        return not stalled.disk.trouble()

    wait_until(is_mended)
    assert stalled.folder.left().token == 1
