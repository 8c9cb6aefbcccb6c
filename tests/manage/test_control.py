"""Where running robots are found, and what is left of those that were killed."""

from __future__ import annotations

import contextlib
import shutil
import socket
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from poise.errors import RunError, UsageError
from poise.manage.control import (
    Answered,
    Asked,
    AskStop,
    ControlServer,
    Refusal,
    Stopping,
    ask,
)
from poise.wire import record_channel

LIMIT = 20.0


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give this test a folder for desks of its own."""
    with tempfile.TemporaryDirectory() as runtime:  # pytest's are too long for sockets
        monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
        yield Path(runtime) / "poise"


@pytest.fixture
def control_server() -> Iterator[ControlServer]:
    control_server = ControlServer("first")
    yield control_server
    control_server.close()


def test_answers_whoever_asks(control_server: ControlServer) -> None:
    asked: list[Asked] = []

    def answer(what: Asked) -> Answered:
        asked.append(what)
        return Answered(Stopping())

    with ThreadPoolExecutor() as pool:
        answered = pool.submit(ask, None, AskStop())
        # to be found, it is connected to once before
        while not answered.done():
            control_server.serve(answer, 0.05)
        assert answered.result(LIMIT) == Stopping()
    assert asked == [Asked(AskStop())]


def test_a_refusal_is_the_askers_error(control_server: ControlServer) -> None:
    with ThreadPoolExecutor() as pool:
        answered = pool.submit(ask, "first", AskStop())
        while not answered.done():
            control_server.serve(lambda _: Answered(Refusal("not today")), 0.05)
        with pytest.raises(UsageError, match="not today"):
            answered.result(LIMIT)


def test_nothing_is_done_for_who_has_left(
    control_server: ControlServer, folder: Path
) -> None:
    with socket.socket(socket.AF_UNIX) as asker:
        asker.connect(str(folder / "first.sock"))
        record_channel.send(asker, Asked(AskStop()))
    done: list[Asked] = []

    def answer(what: Asked) -> Answered:
        done.append(what)
        return Answered(Stopping())

    assert control_server.serve(answer, LIMIT)
    assert not control_server.serve(answer, 0.0)
    assert done == []


def test_who_still_waits_is_told_that_the_robot_has_stopped(folder: Path) -> None:
    control_server = ControlServer("first")
    with socket.socket(socket.AF_UNIX) as asker:
        asker.connect(str(folder / "first.sock"))
        record_channel.send(asker, Asked(AskStop()))
        control_server.close()
        told = record_channel.receive(asker, Answered).what
    assert told == Refusal("robot 'first' has stopped")


def test_a_desk_at_which_many_wait_is_found(
    control_server: ControlServer, folder: Path
) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(1000):
            asker = stack.enter_context(socket.socket(socket.AF_UNIX))
            asker.setblocking(False)
            try:
                asker.connect(str(folder / "first.sock"))
            except BlockingIOError:
                break
        else:
            pytest.fail("the queue has no end")
        with pytest.raises(UsageError, match="robot 'first' runs already"):
            ControlServer("first")
    while control_server.serve(lambda _: Answered(Stopping()), 0.0):
        pass


@pytest.mark.usefixtures("control_server")
def test_a_robot_runs_once() -> None:
    with pytest.raises(UsageError, match="robot 'first' runs already"):
        ControlServer("first")


@pytest.mark.parametrize("runtime", ["/proc/nowhere", f"/tmp/{'long' * 30}"])
def test_a_desk_that_cannot_be_had_says_where(
    runtime: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
    try:
        with pytest.raises(RunError, match=rf"{runtime}/poise/first.sock cannot be"):
            ControlServer("first")
    finally:
        shutil.rmtree(runtime, ignore_errors=True)


@pytest.mark.usefixtures("control_server")
def test_of_several_robots_one_is_to_be_named() -> None:
    other = ControlServer("second")
    with pytest.raises(UsageError, match=r"several robots run \(first, second\)"):
        ask(None, AskStop())
    other.close()
    with pytest.raises(UsageError, match=r"'third' does not run here \(running"):
        ask("third", AskStop())


def test_what_a_killed_manager_left_is_removed(folder: Path) -> None:
    folder.mkdir()
    for name in ("first", "killed"):
        with socket.socket(socket.AF_UNIX) as left:
            left.bind(str(folder / f"{name}.sock"))
    with pytest.raises(UsageError, match="no robot runs here"):
        ask(None, AskStop())
    control_server = ControlServer("first")
    assert [file.name for file in folder.iterdir()] == ["first.sock"]
    control_server.close()
    assert list(folder.iterdir()) == []
