"""What a container does when its agent stands still."""

import asyncio
import contextlib
import os
import socket
import subprocess
import sys
import threading
from concurrent.futures import Future
from pathlib import Path
from unittest.mock import Mock

import pytest

from poise import Component
from poise.errors import RunError
from poise.runtime.container.container import Container
from poise.runtime.execution.counters import new_memory
from poise.runtime.hosting.runner import Runner
from poise.waker import wait_readable
from poise.wire import frame
from poise.wire.records.deployment_records import ComponentSpec, ContainerSpec
from poise.wire.records.status_records import (
    ComponentStatus,
    ContainerFailure,
    ContainerStatus,
    FromContainer,
    Summary,
)
from tests.waiting import LIMIT, wait_until

pytestmark = pytest.mark.slow


def test_no_status_waits_for_an_agent_that_stands_still(tmp_path: Path) -> None:
    agent, ours = socket.socketpair()
    with agent, ours:
        container = Container("see", "a", tmp_path, ours, new_memory())
        container._wanted = ContainerSpec(
            name="see", folder="", components=(), connectors=()
        )
        ours.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                ours.send(bytes(1 << 16))
        ours.setblocking(True)
        container._report(container._status())  # raises Timeout if it waits


def test_says_why_it_cannot_begin(tmp_path: Path) -> None:
    """A folder with no file left to make: it ended with exit code 1, and no more."""
    agent, ours = socket.socketpair()
    with agent, ours:
        with pytest.raises(RunError, match="cannot listen in"):
            Container("see", "a", tmp_path / "gone", ours, new_memory())
        failure = frame.RecordReader(agent).next(FromContainer)
    assert isinstance(failure, ContainerFailure)
    assert failure.reason.endswith("gone: No such file or directory")


def test_says_once_what_waits_amid_a_move_that_nobody_finishes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent, ours = socket.socketpair()
    with agent, ours:
        container = Container("see", "a", tmp_path, ours, new_memory())
        for name, is_paused in (("eye", True), ("ear", False)):
            runner = Mock(is_paused=is_paused)
            runner.spec.name = name
            container._runners[name, 0] = runner
        for now in (10.0, 12.0, 13.5, 20.0):
            monkeypatch.setattr(container._clock, "now", lambda now=now: now)
            container._note_pauses()
        container._server.close()
    (said,) = caplog.messages
    assert "'eye' has been paused for 3 s amid a move that nobody finishes" in said


def test_a_text_that_cannot_be_sent_costs_no_other_component_its_status(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = os.fsdecode(b"map-\xff.png")
    eye = ComponentStatus(
        name="eye", state="active", errors=1, error=text, measures={text: Summary()}
    )
    ear = ComponentStatus(name="ear", state="failed", error="deaf")
    status = ContainerStatus(name="see", pid=1, trouble=text, components=(eye, ear))
    agent, ours = socket.socketpair()
    with agent, ours:
        container = Container("see", "a", tmp_path, ours, new_memory())
        container._wanted = ContainerSpec(
            name="see", folder="", components=(), connectors=()
        )
        for _ in range(3):
            container._report(status)
            told = frame.receive_record(agent, FromContainer)
        container._tell_failure(RunError(text))
        failure = frame.receive_record(agent, FromContainer)
        container._server.close()
    assert told.components[1] == ear
    assert (told.components[0].state, told.components[0].errors) == ("active", 1)
    assert "cannot be sent" in told.components[0].error
    assert told.trouble == failure.reason == "map-\\udcff.png"
    assert len(caplog.messages) == 1


def test_what_takes_part_in_a_move_is_told_its_goal_once(tmp_path: Path) -> None:
    """A component that is prepared beside it ends no pause, and no step of a move."""
    specs = (
        ComponentSpec(name="source", epoch=1, goal="stay"),
        ComponentSpec(name="target", epoch=2, goal="inactive"),
        ComponentSpec(name="third", epoch=3, goal="active"),
    )
    keys = [(each.name, each.epoch) for each in specs]
    spec = ContainerSpec(name="see", folder="", components=specs, connectors=())
    agent, ours = socket.socketpair()
    with agent, ours:
        container = Container("see", "a", tmp_path, ours, new_memory())
        container._stats_page = container._wiring = Mock()
        container._wiring.apply.return_value = {}
        moving = [Mock(), Mock()]
        container._runners.update(zip(keys, moving, strict=False))
        prepared: Future[Runner] = Future()
        container._preparing[keys[2]] = specs[2], prepared
        container._hear(spec)
        moving[0].gate.allow_pause.assert_called_once_with()
        moving[1].aim.assert_called_once_with("inactive")
        prepared.set_result(new := Mock())
        assert container._settle()
        container._server.close()
    moving[0].gate.allow_pause.assert_called_once_with()
    moving[1].aim.assert_called_once_with("inactive")
    new.aim.assert_called_once_with("active")


class Idle(Component):
    """Does nothing."""


class Cancelled(Component):
    def __init__(self) -> None:
        raise asyncio.CancelledError("no loop")


def test_a_component_fails_with_whatever_its_class_raises(tmp_path: Path) -> None:
    agent, ours = socket.socketpair()
    with agent, ours:
        container = Container("see", "a", tmp_path, ours, new_memory())
        eye = ComponentSpec(
            name="eye", goal="active", implementation=f"{__name__}:Cancelled"
        )
        spec = ContainerSpec(name="see", folder="", components=(eye,), connectors=())
        container._apply(spec)
        wait_until(container._settle)
        (status,) = container._status().components
        container._server.close()
    assert status.state == "failed"
    assert "CancelledError: no loop" in status.error


@pytest.mark.parametrize("threads_left", [0, 1])
def test_a_component_without_a_thread_fails_and_starts_when_one_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads_left: int
) -> None:
    agent, ours = socket.socketpair()
    with agent, ours:
        container = Container("see", "a", tmp_path, ours, new_memory())
        eye = ComponentSpec(
            name="eye", goal="active", implementation=f"{__name__}:Idle"
        )
        container._wanted = ContainerSpec(
            name="see", folder="", components=(eye,), connectors=()
        )
        start, left = threading.Thread.start, [None] * threads_left

        def limited(thread: threading.Thread) -> None:
            if not left:
                raise RuntimeError("can't start new thread")
            left.pop()
            start(thread)

        monkeypatch.setattr(threading.Thread, "start", limited)
        container._apply(container._wanted)
        wait_until(container._settle)
        (status,) = container._status().components
        left += [None] * 2
        container._start_again()
        wait_until(container._settle)
        (runner,) = container._runners.values()
        assert runner.life_cycle.wait_state({"active"}, 10.0) == "active"
        assert not container._broken
        runner.aim("finalized")
        wait_until(runner.has_ended)
        container._server.close()
    assert status.state == "failed"
    assert "no thread can be started: raise the limit" in status.error


RUN = """
import socket, sys
from pathlib import Path
from poise.runtime.container.container import Container
from poise.runtime.execution.counters import new_memory
agent = socket.socket(fileno=int(sys.argv[1]))
Container("see", "a", Path(sys.argv[2]), agent, new_memory()).run()
"""


def test_says_that_it_ends_because_a_record_is_damaged(tmp_path: Path) -> None:
    agent, its = socket.socketpair()
    with agent, its:
        argv = [sys.executable, "-c", RUN, str(its.fileno()), str(tmp_path)]
        process = subprocess.Popen(
            argv, pass_fds=[its.fileno()], stderr=subprocess.PIPE, text=True
        )
        its.close()
        frame.send_record(agent, ContainerFailure("not for containers"))
        assert wait_readable([agent.fileno()], LIMIT)
        told = frame.receive_record(agent, FromContainer)
        _, said = process.communicate(timeout=LIMIT)
    assert isinstance(told, ContainerFailure)
    assert told.reason in said
    assert process.returncode != 0
