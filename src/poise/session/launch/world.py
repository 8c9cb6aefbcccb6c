"""The simulated world of an emulated robot: a process outside every computer."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from poise import threads
from poise.errors import RobotError, RunError
from poise.model.robot import Robot
from poise.runtime.hosting.command_line import die_with_parent, program
from poise.runtime.waker import wait_readable
from poise.session.callbacks import Check, nothing

READY_LIMIT = 20.0
"""A simulated world says ``ready`` within this time [s]."""
_END_LIMIT = 3.0
_LOOK_EVERY = 0.2
_NICE = -10


class SimulatorProcess:
    """The simulated world's process, and what that starts; its output is read."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._ended = os.pidfd_open(process.pid)
        self._first: bytes | None = None
        self._last = b""
        self._has_spoken = threading.Event()
        self._reader = threads.daemon(self._read, "world")
        self._reader.start()

    def wait_ready(self, check: Check) -> None:
        """Wait for its line ``ready``; RunError when it says something else."""
        deadline = time.monotonic() + READY_LIMIT
        while not self._has_spoken.wait(_LOOK_EVERY):
            check()
            if time.monotonic() > deadline:
                limit = f"{READY_LIMIT:g} s"
                raise RunError(f"the simulator did not say 'ready' in {limit}")
        line = (self._first or b"").decode(errors="replace").strip()
        if line != "ready":
            raise RunError(f"the simulator said {line!r} instead of 'ready'")

    def has_ended(self) -> bool:
        """Return at once whether it ended by itself."""
        # not waited for, its number stays its own, and its group's
        return self._process.returncode is not None or self._is_over(0.0)

    def waited(self) -> float:
        """Return how long it was ready to run and got no CPU [s], while it runs."""
        file = Path("/proc", str(self._process.pid), "schedstat")
        return int(file.read_text().split()[1]) / 1e9

    def result(self) -> Mapping[str, Any]:
        """End it, and return the JSON object of its last line; RunError: none."""
        self.end()
        return _object(self._last.decode(errors="replace"))

    def _read(self) -> None:
        with self._process.stdout or contextlib.nullcontext(()) as lines:
            for line in lines:
                if self._first is None:
                    self._first = line
                    self._has_spoken.set()
                elif line.strip():
                    self._last = line
        self._has_spoken.set()

    def end(self) -> None:
        """End it, if it has not; RunError when it does not."""
        if self._process.returncode is not None:
            return
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._signal(signal.SIGTERM)
        self._is_over(_END_LIMIT)
        self._signal(signal.SIGKILL)
        if not self._is_over(_END_LIMIT):
            raise RunError(f"the simulator still runs {_END_LIMIT:g} s after SIGKILL")
        self._process.wait()
        os.close(self._ended)
        self._reader.join(_END_LIMIT)

    def _is_over(self, limit: float) -> bool:
        return bool(wait_readable([self._ended], limit))

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)


@contextlib.contextmanager
def world_of(
    robot: Robot, folder: Path, check: Check = nothing
) -> Iterator[SimulatorProcess | None]:
    """Run the robot's simulated world, if it has one, in the run's folder."""
    if robot.simulator is None:
        yield None
        return
    process = _start(robot.simulator.command, robot.folder, folder)
    _go_first(process.pid)
    world = SimulatorProcess(process)
    try:
        world.wait_ready(check)
        yield world
    finally:
        with contextlib.suppress(RunError):  # the run is over, one way or the other
            world.end()


def _go_first(process: int) -> None:
    """Give the world priority, real-time or nice: it is to keep up with the clock."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(process, os.SCHED_RR, os.sched_param(1))
        return
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process, _NICE)
    with contextlib.suppress(OSError):
        Path("/proc", str(process), "autogroup").write_text(str(_NICE))


def _start(
    command: tuple[str, ...], robot_folder: str, folder: Path
) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(  # noqa: S603, the robot file's own command
            [program(command[0], robot_folder or "."), *command[1:]],
            cwd=robot_folder or None,
            env={**os.environ, "POISE_RUN": str(folder)},
            stdin=subprocess.PIPE,  # its end tells the world that we are gone
            stdout=subprocess.PIPE,
            start_new_session=True,
            # safe beside other threads: it takes no lock that one of them may hold
            preexec_fn=die_with_parent,  # noqa: PLW1509
        )
    except OSError as error:
        raise RobotError(f"simulator '{command[0]}' cannot start: {error}") from error


def _object(line: str) -> Mapping[str, Any]:
    if not line:
        raise RunError("the simulator ended without a result")
    try:
        found = json.loads(line)
    except json.JSONDecodeError:
        found = None
    if not isinstance(found, dict):
        raise RunError(f"the simulator's last line is no JSON object: {line!r}")
    return found
