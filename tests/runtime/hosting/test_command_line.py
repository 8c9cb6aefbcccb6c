"""Components that are any executable, with real processes."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.runtime.hosting.command_line import Command, environment, program
from poise.runtime.waker import wait_readable
from poise.wire.records.deployment import ComponentSpec

pytestmark = pytest.mark.slow

LIMIT = 20.0


class Running:
    """Starts commands that write to a pipe, so that a test sees when they do."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.channel = folder / "pipe"
        os.mkfifo(self.channel)
        self._end = os.open(self.channel, os.O_RDONLY | os.O_NONBLOCK)
        self._commands: list[Command] = []

    def command(self, *argv: str) -> Command:
        spec = ComponentSpec(
            name="one", goal="active", command=argv, devices={"out": str(self.channel)}
        )
        self._commands.append(Command(spec, str(self._folder)))
        return self._commands[-1]

    def shell(self, script: str) -> Command:
        command = self.command("/bin/sh", "-c", f"exec >$POISE_DEVICE_OUT; {script}")
        command.aim("active")
        return command

    def wait_says(self, what: str) -> None:
        said = ""
        deadline = time.monotonic() + LIMIT
        while what not in said:
            assert time.monotonic() < deadline, said
            assert wait_readable([self._end], LIMIT)
            with contextlib.suppress(BlockingIOError):  # one began as another ended
                said += os.read(self._end, 100).decode()

    def wait_over(self) -> None:
        """Wait until nobody has the pipe open any more."""
        while True:
            assert wait_readable([self._end], LIMIT)
            with contextlib.suppress(BlockingIOError):
                if not os.read(self._end, 100):
                    return

    def close(self) -> None:
        for command in self._commands:
            command.aim("finalized")
            assert command.wait_ended(1.0)
        os.close(self._end)


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    running = Running(tmp_path)
    yield running
    running.close()


def test_it_runs_when_active_and_not_before(running: Running) -> None:
    command = running.command("sleep", "100")
    command.aim("inactive")
    assert command.status().state == "inactive"
    assert not command.watched()
    command.aim("active")
    assert command.status().state == "active"
    command.aim("finalized")
    assert command.wait_ended(LIMIT)
    assert command.status().state == "finalized"


def test_it_knows_who_it_is(running: Running) -> None:
    running.shell("echo I am $POISE_COMPONENT")
    running.wait_says("I am one")


def test_its_environment_holds_parameters_and_devices() -> None:
    spec = ComponentSpec(
        name="driver",
        goal="active",
        parameters={"rate": 5},
        devices={"left-wheel": "/dev/tty1"},
    )
    assert environment(spec) == {
        "POISE_COMPONENT": "driver",
        "POISE_PARAMETERS": '{"rate":5}',
        "POISE_DEVICE_LEFT_WHEEL": "/dev/tty1",
    }


def test_it_is_asked_to_end_and_may_tidy_up(running: Running) -> None:
    command = running.shell(
        "trap 'echo bye; exit' TERM; echo up; while :; do sleep 0.01; done"
    )
    running.wait_says("up")
    command.aim("finalized")
    assert command.wait_ended(LIMIT)
    running.wait_says("bye")


def test_one_that_will_not_end_is_killed(running: Running) -> None:
    command = running.shell("trap '' TERM; echo up; while :; do sleep 0.01; done")
    running.wait_says("up")
    command.aim("finalized")
    assert command.wait_ended(0.05)
    running.wait_over()


def test_what_it_started_ends_with_it(running: Running) -> None:
    command = running.shell("sleep 100 & echo up; exec sleep 100")
    running.wait_says("up")
    command.aim("finalized")
    assert command.wait_ended(LIMIT)
    running.wait_over()


@pytest.mark.parametrize(
    ("script", "how"), [("exit 3", "exit code 3"), ("kill -9 $$", "SIGKILL")]
)
def test_it_is_seen_when_it_ends_by_itself(
    running: Running, script: str, how: str
) -> None:
    command = running.shell(script)
    assert wait_readable(command.watched(), LIMIT)
    with pytest.raises(ChildProcessError, match=f"'one': its command ended with {how}"):
        command.raise_if_ended()
    assert how in command.status().error
    command.raise_if_ended()  # told once


def test_one_that_was_asked_to_end_is_inactive_then(running: Running) -> None:
    command = running.shell("exec sleep 100")
    command.aim("inactive")
    assert wait_readable(command.watched(), LIMIT)
    command.raise_if_ended()
    assert command.status().state == "inactive"
    assert not command.watched()


def test_one_that_is_wanted_again_while_it_ends_begins_anew(running: Running) -> None:
    command = running.shell("trap 'echo bye; exit' TERM; echo up; sleep 9 & wait")
    running.wait_says("up")
    command.aim("inactive")
    command.aim("active")
    running.wait_says("bye")
    assert wait_readable(command.watched(), LIMIT)
    command.raise_if_ended()
    assert command.status().state == "active"
    running.wait_says("up")


@pytest.mark.parametrize("name", ["no-such-program", "./no-such-file"])
def test_a_program_that_is_not_there_fails_before_anything_runs(
    running: Running, name: str
) -> None:
    command = running.command(name)
    command.aim("inactive")
    assert command.status().state == "failed"
    assert f"'{name}' cannot be started: there is no such program" in (
        command.status().error
    )


def test_arguments_that_no_program_can_get_fail_it(running: Running) -> None:
    command = running.command(sys.executable, "a\0b")
    command.aim("active")
    assert command.status().state == "failed"
    assert "null byte" in command.status().error


def test_a_program_may_lie_beside_the_robot_file(tmp_path: Path) -> None:
    script = tmp_path / "driver"
    script.write_text("#!/bin/sh\n")
    script.chmod(0o755)
    assert program("./driver", str(tmp_path)) == str(script.resolve())


def test_python_is_the_one_that_poise_runs_in() -> None:
    assert program("python", ".") == sys.executable


def test_its_cpu_time_is_counted(running: Running) -> None:
    command = running.shell("while :; do :; done")
    while command.counters.cpu() < 0.001:
        pass
    assert command.status().cpu >= 0.001


def test_it_does_not_survive_a_container_that_is_killed(running: Running) -> None:
    out = os.open(running.channel, os.O_WRONLY)
    with subprocess.Popen([sys.executable, "-c", KEEPER], stdout=out) as container:
        os.close(out)
        running.wait_says("\n")
        container.kill()
    running.wait_over()


KEEPER = """
import signal
from poise.runtime.hosting.command_line import Command
from poise.wire.records.deployment import ComponentSpec

command = ("sh", "-c", "echo; exec sleep 9")
spec = ComponentSpec(name="one", goal="active", command=command)
Command(spec, ".").aim("active")
signal.pause()
"""
