"""The control socket: how commands come in, and what is left of killed managers."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import shutil
import socket
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any, cast

import pytest

from poise.errors import RobotError, RunError, UsageError
from poise.manage.control_socket import control_server
from poise.manage.control_socket.commands import (
    Command,
    MoveCommand,
    Refusal,
    Response,
    Result,
    StatusCommand,
    StopCommand,
    StopReport,
)
from poise.manage.control_socket.control_client import send_command
from poise.manage.control_socket.control_server import ControlServer, Submit
from poise.wire import frame
from poise.wire.robots_here import running_here
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

LIMIT = 20.0


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give this test a folder for control sockets of its own."""
    with tempfile.TemporaryDirectory() as runtime:  # pytest's are too long for sockets
        monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
        yield Path(runtime) / "poise"


@pytest.fixture
def server() -> Iterator[ControlServer]:
    with ControlServer("first") as server:
        yield server


class Manager:
    """Takes commands, and answers when the test says."""

    def __init__(self) -> None:
        self.taken: SimpleQueue[tuple[Command, Future[Result | Refusal]]] = (
            SimpleQueue()
        )

    def submit(self, command: Command) -> Future[Result | Refusal]:
        future: Future[Result | Refusal] = Future()
        self.taken.put((command, future))
        return future


def answering(result: Result | Refusal) -> Submit:
    done: Future[Result | Refusal] = Future()
    done.set_result(result)
    return lambda _: done


def test_returns_the_managers_result(server: ControlServer) -> None:
    manager = Manager()
    server.start(manager.submit)
    with ThreadPoolExecutor() as pool:
        result = pool.submit(send_command, None, StopCommand())
        command, future = manager.taken.get(timeout=LIMIT)
        future.set_result(StopReport(("a container",)))
        assert result.result(LIMIT) == StopReport(("a container",))
    assert command == StopCommand()


def test_a_program_with_many_connections_asks_the_manager(
    server: ControlServer,
) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 < hard < 1400:
        pytest.skip("it may not have many files open")
    server.start(answering(StopReport()))
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 1400), hard))
    many = [os.open(os.devnull, os.O_RDONLY) for _ in range(1024)]
    try:
        assert send_command(None, StopCommand()) == StopReport()
    finally:
        for each in many:
            os.close(each)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_folder_that_is_read_only_meanwhile_lets_the_manager_end(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(path: Path) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    socket_path = folder / "first.sock"
    with monkeypatch.context() as patch:
        with ControlServer("first"):
            patch.setattr(Path, "unlink", refuse)
        assert str(socket_path) in caplog.text
    with pytest.raises(ConnectionRefusedError), socket.socket(socket.AF_UNIX) as client:
        client.connect(str(socket_path))


def test_a_damaged_note_of_another_robot_does_no_harm(
    server: ControlServer, folder: Path
) -> None:
    server.start(answering(StopReport()))
    note = folder / "second.agents"
    note.write_text("nonsense")
    assert send_command("first", StopCommand()) == StopReport()
    for robot in (None, "second"):
        with pytest.raises(RunError, match=rf"{note}: .*: remove it"):
            send_command(robot, StopCommand())


def test_a_status_says_that_the_robot_starts(server: ControlServer) -> None:
    with pytest.raises(RunError, match=r"'first' has been starting since \d\d:"):
        send_command("first", StatusCommand())
    with ThreadPoolExecutor() as threads:
        waiting = threads.submit(send_command, "first", StopCommand())
        server.start(answering(StopReport()))
        assert waiting.result(LIMIT) == StopReport()


def test_who_waits_for_the_start_is_told_when_it_fails(folder: Path) -> None:
    with socket.socket(socket.AF_UNIX) as client:
        with ControlServer("first") as server:
            client.connect(str(folder / "first.sock"))
            frame.send_record(client, StopCommand())
            wait_until(lambda: bool(server._threads), LIMIT)
        answer = frame.receive_record(client, Response)
    assert answer == Refusal("robot 'first' did not start", "RunError")


def test_a_status_overtakes_a_move(server: ControlServer) -> None:
    manager = Manager()
    server.start(manager.submit)
    with ThreadPoolExecutor() as pool:
        move = pool.submit(send_command, "first", MoveCommand("a", "left"))
        _, moving = manager.taken.get(timeout=LIMIT)
        status = pool.submit(send_command, "first", StatusCommand())
        _, asked = manager.taken.get(timeout=LIMIT)
        asked.set_result(StopReport(("any",)))
        assert status.result(LIMIT) == StopReport(("any",))
        assert not move.done()
        moving.set_result(StopReport())
        move.result(LIMIT)


@pytest.mark.parametrize("error", [UsageError, RobotError, RunError])
def test_a_refusal_is_the_clients_error(
    server: ControlServer, error: type[Exception]
) -> None:
    refusal = Refusal.from_error(error("not today"))  # type: ignore[arg-type]
    server.start(answering(refusal))
    with pytest.raises(error, match="not today"):
        send_command("first", StopCommand())


def test_a_command_of_wrong_types_is_refused(server: ControlServer) -> None:
    taken = Manager()
    server.start(taken.submit)
    nobody = cast("Any", None)
    with pytest.raises(UsageError, match="no such command: Expected `str`"):
        send_command("first", MoveCommand(nobody, "right"))
    assert taken.taken.empty()


def test_a_client_that_leaves_cancels_its_command(
    server: ControlServer, folder: Path
) -> None:
    manager = Manager()
    server.start(manager.submit)
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(folder / "first.sock"))
        frame.send_record(client, StopCommand())
        _, future = manager.taken.get(timeout=LIMIT)
        assert not future.cancelled()
    wait_until(future.cancelled)


def test_a_client_that_waits_is_refused_when_the_robot_stops(folder: Path) -> None:
    manager = Manager()
    with ControlServer("first") as server, socket.socket(socket.AF_UNIX) as client:
        server.start(manager.submit)
        client.connect(str(folder / "first.sock"))
        frame.send_record(client, MoveCommand("a", "left"))
        manager.taken.get(timeout=LIMIT)
        server.close()
        told = frame.receive_record(client, Response)
    assert told == Refusal("robot 'first' has stopped", "RunError")


def test_a_silent_client_holds_up_nobody(server: ControlServer, folder: Path) -> None:
    server.start(answering(StopReport()))
    with contextlib.ExitStack() as stack:
        for _ in range(20):
            client = stack.enter_context(socket.socket(socket.AF_UNIX))
            client.connect(str(folder / "first.sock"))
        assert send_command("first", StopCommand()) == StopReport()


def test_commands_that_take_long_leave_room_for_a_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(control_server, "MOST_OTHERS", 2)
    manager, move = Manager(), MoveCommand("a", "left")
    with ControlServer("first") as server, ThreadPoolExecutor() as pool:
        server.start(manager.submit)
        moves = [pool.submit(send_command, None, move) for _ in range(2)]
        taken = [manager.taken.get(timeout=LIMIT) for _ in moves]
        with pytest.raises(RunError, match="'first' has 2 commands under way"):
            send_command(None, move)
        stop = pool.submit(send_command, None, StopCommand())
        taken.append(manager.taken.get(timeout=LIMIT))
        for _, future in taken:
            future.set_result(StopReport())
        assert {each.result(LIMIT) for each in (*moves, stop)} == {StopReport()}
    assert control_server.MOST_OTHERS < control_server.MOST_CLIENTS


def test_clients_that_were_served_are_forgotten(
    server: ControlServer, folder: Path
) -> None:
    """They leave at once: some may be served before the server looks again."""
    server.start(answering(StopReport()))
    for _ in range(200):
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(folder / "first.sock"))
    wait_until(lambda: not server._threads, LIMIT)


@pytest.mark.usefixtures("server")
def test_a_socket_at_which_many_wait_is_found(folder: Path) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(1000):
            client = stack.enter_context(socket.socket(socket.AF_UNIX))
            client.setblocking(False)
            try:
                client.connect(str(folder / "first.sock"))
            except BlockingIOError:
                break
        else:
            pytest.fail("the queue has no end")
        with pytest.raises(UsageError, match="robot 'first' runs already"):
            ControlServer("first")


@pytest.mark.usefixtures("server")
def test_a_robot_runs_once() -> None:
    with pytest.raises(UsageError, match="robot 'first' runs already"):
        ControlServer("first")


def test_a_manager_that_was_not_taken_over_takes_commands_again(
    server: ControlServer, folder: Path
) -> None:
    server.start(answering(StopReport()))
    with ControlServer("first", takes_over=True):
        pass  # it failed before it led
    assert send_command("first", StopCommand()) == StopReport()
    with ControlServer("first", takes_over=True) as second:
        second.start(answering(StopReport(("a container",))))
        server.close()
        answer = send_command("first", StopCommand())
        assert [file.name for file in folder.iterdir()] == ["first.sock"]
    assert answer == StopReport(("a container",))
    assert list(folder.iterdir()) == []


def test_a_manager_takes_commands_again_when_who_took_over_was_killed(
    server: ControlServer, folder: Path
) -> None:
    server.start(answering(StopReport()))
    path = folder / "first.sock"
    path.rename(folder / "first.former")
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(os.fspath(path))
    assert running_here() == ["first"]
    assert send_command("first", StopCommand()) == StopReport()
    assert [file.name for file in folder.iterdir()] == ["first.sock"]


@pytest.mark.parametrize("runtime", ["/proc/nowhere", f"/tmp/{'long' * 30}"])
def test_a_socket_that_cannot_be_had_says_where(
    runtime: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
    try:
        where = rf"cannot listen on {runtime}/poise/first.sock"
        with pytest.raises(RunError, match=where):
            ControlServer("first")
    finally:
        shutil.rmtree(runtime, ignore_errors=True)


@pytest.mark.usefixtures("server")
def test_of_several_robots_one_is_to_be_named() -> None:
    several = pytest.raises(UsageError, match=r"several robots run \(first, second\)")
    with ControlServer("second"), several:
        send_command(None, StopCommand())
    with pytest.raises(UsageError, match=r"'third' does not run here \(running"):
        send_command("third", StopCommand())


def test_what_a_killed_manager_left_is_removed(folder: Path) -> None:
    folder.mkdir()
    for name in ("first", "killed"):
        with socket.socket(socket.AF_UNIX) as left:
            left.bind(str(folder / f"{name}.sock"))
    with pytest.raises(UsageError, match="no robot runs here"):
        send_command(None, StopCommand())
    with ControlServer("first"):
        assert [file.name for file in folder.iterdir()] == ["first.sock"]
    assert list(folder.iterdir()) == []


def test_goes_on_when_no_descriptor_was_free(
    server: ControlServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.start(answering(StopReport()))
    accept, full = socket.socket.accept, threading.Event()

    def refuse(listener: socket.socket) -> tuple[socket.socket, object]:
        connection, _ = accept(listener)
        if full.is_set():
            return connection, None
        full.set()
        connection.close()
        raise OSError(errno.EMFILE, "no descriptor is free")

    monkeypatch.setattr(socket.socket, "accept", refuse)
    with contextlib.suppress(RunError):
        send_command(None, StopCommand())  # perhaps taken before that
        send_command(None, StopCommand())
    assert full.wait(LIMIT)
    assert send_command(None, StopCommand()) == StopReport()


@pytest.mark.usefixtures("server")
def test_a_client_for_which_no_descriptor_is_free_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The dashboard, say: it reads the robot again when one is free."""

    def refuse(*_: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket, "socket", refuse)
    with pytest.raises(RunError, match=r"looked for: .* Too many open files"):
        send_command(None, StopCommand())
