"""Components that are any executable, with real processes."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.clock import SystemClock
from poise.runtime.container.component_import import implementation_of
from poise.runtime.hosting.command_line import CommandLine, program, runnable
from poise.runtime.hosting.runner import Runner
from poise.waker import wait_readable
from poise.wire.records.deployment_records import ComponentSpec
from poise.wire.records.status_records import State
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

LIMIT = 20.0


def runner_of(spec: ComponentSpec, folder: Path) -> Runner:
    """Return a command-line component's runner; it is started."""
    implementation = implementation_of(spec, str(folder))
    runner = Runner(spec, implementation, SystemClock(), lambda: None)
    runner.start()
    return runner


def reach(runner: Runner, state: State) -> None:
    """Wait until a component is in a state that it was told to reach."""
    assert runner.life_cycle.wait_state({state}, LIMIT) == state


class Running:
    """Starts commands that write to a pipe, so that a test sees when they do."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.channel = folder / "pipe"
        os.mkfifo(self.channel)
        self.reading = os.open(self.channel, os.O_RDONLY | os.O_NONBLOCK)
        self._runners: list[Runner] = []

    def command(self, *argv: str) -> Runner:
        spec = ComponentSpec(
            name="one", goal="active", command=argv, devices={"out": str(self.channel)}
        )
        self._runners.append(runner_of(spec, self._folder))
        return self._runners[-1]

    def shell(self, script: str) -> Runner:
        runner = self.command("/bin/sh", "-c", f"exec >$POISE_DEVICE_OUT; {script}")
        runner.aim("active")
        return runner

    def wait_says(self, what: str) -> None:
        said = ""
        deadline = time.monotonic() + LIMIT
        while what not in said:
            assert time.monotonic() < deadline, said
            assert wait_readable([self.reading], LIMIT)
            with contextlib.suppress(BlockingIOError):  # one began as another ended
                said += os.read(self.reading, 100).decode()

    def wait_over(self) -> None:
        """Wait until nobody has the pipe open any more."""
        while True:
            assert wait_readable([self.reading], LIMIT)
            with contextlib.suppress(BlockingIOError):
                if not os.read(self.reading, 100):
                    return

    def close(self) -> None:
        for runner in self._runners:
            runner.aim("finalized")
            assert runner.wait_ended(LIMIT)
        os.close(self.reading)


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    running = Running(tmp_path)
    yield running
    running.close()


def test_it_runs_when_active_and_not_before(running: Running) -> None:
    runner = running.command("/bin/sh", "-c", "echo up >$POISE_DEVICE_OUT; sleep 9")
    reach(runner, "inactive")
    assert not wait_readable([running.reading], 0.05)
    runner.aim("active")
    running.wait_says("up")
    reach(runner, "active")
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)
    running.wait_over()
    assert runner.status().state == "finalized"


def test_it_knows_who_it_is(running: Running) -> None:
    running.shell("echo I am $POISE_COMPONENT")
    running.wait_says("I am one")


def test_its_environment_holds_parameters_and_devices(tmp_path: Path) -> None:
    spec = ComponentSpec(
        name="driver",
        goal="active",
        command=("env",),
        parameters={"rate": 5},
        devices={"left-wheel": "/dev/tty1"},
    )
    runner = runner_of(spec, tmp_path)
    runner.aim("finalized")
    assert isinstance(runner.component, CommandLine)
    assert runner.component.environment() == {
        "POISE_COMPONENT": "driver",
        "POISE_PARAMETERS": '{"rate":5}',
        "POISE_DEVICE_LEFT_WHEEL": "/dev/tty1",
    }
    assert runner.wait_ended(LIMIT)


def test_it_is_asked_to_end_and_may_tidy_up(running: Running) -> None:
    runner = running.shell(
        "trap 'echo bye; exit' TERM; echo up; while :; do sleep 0.01; done"
    )
    running.wait_says("up")
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)
    running.wait_says("bye")


def test_one_that_will_not_end_is_killed(
    running: Running, caplog: pytest.LogCaptureFixture
) -> None:
    runner = running.shell("trap '' TERM; echo up; while :; do sleep 0.01; done")
    running.wait_says("up")
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)
    running.wait_over()
    said = "its command did not end within 5 s of SIGTERM: it is killed"
    assert [record.getMessage() for record in caplog.records] == [said]


def test_what_it_started_ends_with_it(running: Running) -> None:
    runner = running.shell("sleep 100 & echo up; exec sleep 100")
    running.wait_says("up")
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)
    running.wait_over()


def test_daemons_that_it_started_stop_and_end_with_it() -> None:
    """They are orphans in sessions of their own, which their container adopts."""
    subprocess.run([sys.executable, "-c", DAEMON], check=True, timeout=LIMIT)


DAEMON = """
import os
from pathlib import Path
from poise.runtime.hosting.descendants import adopt_orphans, children
from poise.wire.records.deployment_records import ComponentSpec
from tests.runtime.hosting.test_command_line import reach, runner_of
from tests.waiting import wait_until

def state(process):
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]

def program(process):
    return Path(f"/proc/{process}/cmdline").read_text().split("\\0")[0]

adopt_orphans()
daemon = "trap '' TERM; exec sleep 100"
command = ("sh", "-c", f'(setsid sh -c "{daemon}" &); exec sleep 100')
runner = runner_of(ComponentSpec(name="one", goal="active", command=command), Path())
runner.aim("active")
reach(runner, "active")
wait_until(lambda: [program(c) for c in children()] == 2 * ["sleep"])
assert len({os.getsid(c) for c in children()}) == 2
runner.component.freeze(is_frozen=True)
wait_until(lambda: all(state(c) == "T" for c in children()))
runner.component.freeze(is_frozen=False)
runner.aim("inactive")
reach(runner, "inactive")
assert all(state(c) == "Z" for c in children())
"""


@pytest.mark.parametrize(
    ("script", "how"),
    [
        ("exit 3", "exit code 3"),
        ("exit 0", "exit code 0: it should run in the foreground until SIGTERM"),
        ("kill -9 $$", "SIGKILL"),
        ("kill -40 $$", "signal 40"),
    ],
)
def test_its_container_learns_when_it_ends_by_itself(
    running: Running, script: str, how: str
) -> None:
    runner = running.shell(f"sleep 100 & {script}")
    wait_until(lambda: runner.reason_to_end)
    assert runner.reason_to_end == f"component 'one': its command ended with {how}"
    running.wait_over()  # what it started ended with it


def test_one_that_was_asked_to_end_is_inactive_then(running: Running) -> None:
    runner = running.shell("echo up; exec sleep 100")
    running.wait_says("up")
    runner.aim("inactive")
    reach(runner, "inactive")
    running.wait_over()
    assert not runner.reason_to_end


@pytest.mark.parametrize("script", ["exit 3", "kill -9 $$"])
def test_its_last_words_are_passed_on_before_its_container_ends(
    running: Running, script: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Even where they fill the pipe."""
    runner = running.command("/bin/sh", "-c", f"seq 1 20000; {script}")
    runner.aim("active")
    wait_until(lambda: runner.reason_to_end)
    assert capsys.readouterr().out.endswith("\n20000\n")


def test_what_keeps_its_output_open_does_not_keep_it(running: Running) -> None:
    script = "setsid sleep 100 & echo $! >$POISE_DEVICE_OUT; exit 3"
    runner = running.command("/bin/sh", "-c", script)
    runner.aim("active")
    wait_until(lambda: runner.reason_to_end)
    os.kill(int(os.read(running.reading, 100)), signal.SIGKILL)


def test_one_that_is_wanted_again_while_it_ends_begins_anew(running: Running) -> None:
    runner = running.shell("trap 'echo bye; exit' TERM; echo up; sleep 9 & wait")
    running.wait_says("up")
    reach(runner, "active")
    runner.aim("inactive")
    running.wait_says("bye")
    runner.aim("active")
    running.wait_says("up")
    reach(runner, "active")


@pytest.mark.parametrize("name", ["no-such-program", "./no-such-file"])
def test_a_program_that_is_not_there_fails_before_anything_runs(
    running: Running, name: str
) -> None:
    runner = running.command(name)
    reach(runner, "failed")
    assert runner.status().error.startswith(
        f"'{name}' cannot be started: there is no such program"
    )
    assert runner.status().errors == 1


def test_a_script_that_is_not_there_fails_before_anything_runs(
    running: Running,
) -> None:
    runner = running.command("python", "nodes/eye.py", "--fast")
    reach(runner, "failed")
    said = runner.status().error
    assert said.startswith("'python' cannot be started: there is no such script as /")
    assert said.endswith("/nodes/eye.py")


def test_a_file_that_may_not_be_executed_is_told_from_none(tmp_path: Path) -> None:
    (tmp_path / "plan.sh").touch(0o644)
    with pytest.raises(PermissionError, match=r"/plan.sh may not be executed: see `"):
        runnable(("./plan.sh",), str(tmp_path))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"sleep 9\n", "/plan.sh is text whose first line does not say which program"),
        (b"#!/no/sh -e\n", "/plan.sh is to be run by '/no/sh', as its first line says"),
        (b"#!/bin/sh\r\n", r"/plan.sh is to be run by '/bin/sh\\r'"),
        (b"#! /bin/sh -e\n", ""),
        (b"#!/bin/sh", ""),
        (b"\x7fELF\0\0", ""),
        (b"", ""),
    ],
)
def test_a_script_says_which_program_runs_it(
    tmp_path: Path, text: bytes, says: str
) -> None:
    script = tmp_path / "plan.sh"
    script.write_bytes(text)
    script.chmod(0o755)
    if says:
        with pytest.raises(OSError, match=says):
            runnable(("./plan.sh", "9"), str(tmp_path))
    else:
        runnable(("./plan.sh", "9"), str(tmp_path))


@pytest.mark.parametrize("argument", ["plan.py", "--version", "-c", "."])
def test_python_gets_its_script_or_options(tmp_path: Path, argument: str) -> None:
    (tmp_path / "plan.py").touch()
    argv = runnable(("python", argument), str(tmp_path))
    assert argv == [sys.executable, argument]
    assert runnable(("python",), str(tmp_path)) == [sys.executable]


def test_arguments_that_no_program_can_get_fail_it(running: Running) -> None:
    runner = running.command(sys.executable, "a\0b")
    runner.aim("active")
    reach(runner, "failed")
    error = runner.status().error
    assert error == f"'{sys.executable}' cannot be started: embedded null byte"


def test_a_program_may_lie_beside_the_robot_file(tmp_path: Path) -> None:
    script = tmp_path / "driver"
    script.write_text("#!/bin/sh\n")
    script.chmod(0o755)
    assert program("./driver", str(tmp_path)) == str(script.resolve())


def test_a_link_stays_one_for_so_is_the_python_of_a_virtual_environment(
    tmp_path: Path,
) -> None:
    link = tmp_path / "python"
    link.symlink_to(sys.executable)
    assert program(str(link), ".") == str(link)


def test_python_is_the_one_that_poise_runs_in() -> None:
    assert program("python", ".") == sys.executable


def test_its_cpu_time_is_counted_and_stays_when_it_ends(running: Running) -> None:
    runner = running.shell("while :; do :; done")
    wait_until(lambda: runner.counters.cpu() > 0.1)  # more than its thread needs
    assert runner.status().cpu > 0.1
    runner.aim("inactive")
    assert runner.life_cycle.wait_state({"inactive"}, LIMIT) == "inactive"
    assert runner.status().cpu > 0.1  # a report of a run looks at this


def test_it_does_not_survive_a_container_that_is_killed(running: Running) -> None:
    out = os.open(running.channel, os.O_WRONLY)
    with subprocess.Popen([sys.executable, "-c", KEEPER], stdout=out) as container:
        os.close(out)
        running.wait_says("\n")
        container.kill()
    running.wait_over()


KEEPER = """
import signal
from pathlib import Path
from poise.wire.records.deployment_records import (ComponentSpec)
from tests.runtime.hosting.test_command_line import runner_of

command = ("sh", "-c", "echo; exec sleep 9")
spec = ComponentSpec(name="one", goal="active", command=command)
runner_of(spec, Path()).aim("active")
signal.pause()
"""


def test_finds_the_executable_of_a_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "overlay/lib/nav_stack/scan_filter"
    file.parent.mkdir(parents=True)
    file.write_text("#!/bin/sh\n")
    file.chmod(0o755)
    prefixes = f"{tmp_path}/overlay:{tmp_path}/base"
    monkeypatch.setenv("AMENT_PREFIX_PATH", prefixes)
    assert program("ros2:nav_stack/scan_filter", "/") == str(file)
    assert program("ros2:nav_stack/sh", "/").endswith("/sh")  # a script on the PATH
    with pytest.raises(FileNotFoundError) as error:
        program("ros2:nav_stack/scan_filters", "/")
    assert "did you mean 'scan_filter'?" in str(error.value)
    assert f"{tmp_path}/base/lib/nav_stack" in str(error.value)


def test_says_that_ros_2_was_not_sourced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with pytest.raises(FileNotFoundError, match=r"source the setup\.bash"):
        program("ros2:nav_stack/scan_filter", "/")
