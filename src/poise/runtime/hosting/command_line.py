"""A component that is any executable: one process, which this watches.

It has the environment of the agent and ``POISE_COMPONENT`` (its name),
``POISE_PARAMETERS`` (a JSON object) and, for each device, ``POISE_DEVICE_<NAME>`` (its
path; the name in capitals, ``_`` for ``-``). Poise does not wire it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import msgspec

from poise import threads
from poise.errors import RobotError, did_you_mean, listed, signal_name
from poise.runtime.component.component import Component
from poise.runtime.hosting.descendants import children
from poise.runtime.hosting.output import LONGEST, write_as

if TYPE_CHECKING:
    from poise.runtime.hosting.runner import Runner

_STOP_LIMIT = 5.0
"""A process that was asked to end is killed after this time [s], as by ROS 2."""
_OUTPUT_LIMIT = 1.0
"""What it wrote is read for so long after its end [s]: a child may keep its pipe."""
_GONE_LIMIT, _LOOK = 0.5, 0.01
"""What was killed is waited for so long, and looked at so often [s]."""
_KILL_LIMIT = 0.5 + _GONE_LIMIT + _OUTPUT_LIMIT
_NAME = "POISE_COMPONENT"
"""The variable that tells a command, and what it starts, which component it is."""
_PYTHON = {"python", "python3"}
_PR_SET_PDEATHSIG = 1
_prctl = ctypes.CDLL(None).prctl


class CommandLine(Component):
    """Is inactive when its program was found, active while its process runs."""

    command: ClassVar[tuple[str, ...]]
    folder: ClassVar[str]
    """Where it is run, and where its program is looked for first."""
    variables: ClassVar[Mapping[str, str]] = {}
    """Further environment variables."""

    def configure(self) -> None:
        """Look for the program."""
        try:
            self._argv = runnable(self.command, self.folder)
        except OSError as error:
            raise self._not_started(error) from None

    def activate(self) -> None:
        """Start the process."""
        try:
            self._process = subprocess.Popen(  # noqa: S603, the robot file's own command
                self._argv,
                cwd=self.folder,
                env={**os.environ, **self.environment()},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                # safe beside other threads: it takes no lock that one of them may hold
                preexec_fn=_before_command,  # noqa: PLW1509
            )
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            raise self._not_started(error) from None
        self._context.count_process(self._process.pid)
        self._is_stopping = self._is_frozen = False
        self._reader = threads.daemon(self._pass_output_on, "output")
        self._reader.start()
        self._watcher = threads.daemon(self._watch, "command")
        self._watcher.start()

    def deactivate(self) -> None:
        """Ask the process to end, and kill one that does not."""
        self._is_stopping = True
        self._context.count_process(0)  # while it is there to be asked
        for number, limit in (
            (signal.SIGTERM, _STOP_LIMIT),
            (signal.SIGKILL, _KILL_LIMIT),
        ):
            if number == signal.SIGKILL:
                text = "its command did not end within %g s of SIGTERM: it is killed"
                self.log.warning(text, _STOP_LIMIT)
            self._signal(number)
            self._signal(signal.SIGCONT)
            self._watcher.join(limit)
            if not self._watcher.is_alive():
                break

    def freeze(self, *, is_frozen: bool) -> None:
        """Stop the process, or let it go on; harmless when repeated."""
        if is_frozen != self._is_frozen:
            self._is_frozen = is_frozen
            self._signal(signal.SIGSTOP if is_frozen else signal.SIGCONT)

    def environment(self) -> dict[str, str]:
        """Return what the process finds in its environment."""
        devices = {
            f"POISE_DEVICE_{name.upper().replace('-', '_')}": path
            for name, path in self._context.devices.items()
        }
        return {
            _NAME: self.name,
            "POISE_PARAMETERS": msgspec.json.encode(self.parameters).decode(),
            **devices,
            **self.variables,
        }

    def _pass_output_on(self) -> None:
        """Write what the process writes, as this component."""
        write_as(self.name)
        output = self._process.stdout
        assert output is not None  # noqa: S101, it was asked for
        with output:
            while line := output.readline(LONGEST):
                sys.stdout.write(line.decode(errors="replace").rstrip("\n") + "\n")
                sys.stdout.flush()

    def _watch(self) -> None:
        """Wait for the end of the process, and end what it started along."""
        os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOWAIT)
        self._end_all()
        code = self._process.wait()
        self._reader.join(_OUTPUT_LIMIT)  # its last words tell why it ended
        if not self._is_stopping:
            how = f"exit code {code}" if code >= 0 else signal_name(-code)
            advice = "" if code else ": it should run in the foreground until SIGTERM"
            self._context.give_up(f"its command ended with {how}{advice}")

    def _end_all(self) -> None:
        """Kill all of its processes, and wait until they are gone."""
        deadline = time.monotonic() + _GONE_LIMIT
        self._signal(signal.SIGKILL)
        while self._processes() and time.monotonic() < deadline:
            time.sleep(_LOOK)
            self._signal(signal.SIGKILL)

    def _signal(self, number: signal.Signals) -> None:
        """Send a signal to the process group, and to its other processes."""
        group = self._process.pid
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, number)
        for process in self._processes():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                if os.getpgid(process) != group:
                    os.kill(process, number)

    def _processes(self) -> list[int]:
        """Return its processes, also those that left its session and parent."""
        found, parents = list[int](), [os.getpid()]
        while parents:
            for child in children(parents.pop()):
                parents.append(child)
                with contextlib.suppress(OSError):  # it has ended, or gained rights
                    environment = Path(f"/proc/{child}/environ").read_bytes()
                    if f"{_NAME}={self.name}".encode() in environment.split(b"\0"):
                        found.append(child)
        return found

    def _not_started(self, error: Exception) -> RobotError:
        return RobotError(f"'{self.command[0]}' cannot be started: {error}")


def runnable(command: Sequence[str], folder: str) -> list[str]:
    """Return a command line with its program's path; OSError: what lacks."""
    name, *arguments = command
    script = Path(folder, arguments[0]).absolute() if arguments else Path()
    if name in _PYTHON and not script.exists() and not arguments[0].startswith("-"):
        raise FileNotFoundError(f"there is no such script as {script}")
    path = program(name, folder)
    _check_first_line(path)
    return [path, *arguments]


_BEGINNING = 256
"""So much of a script the kernel reads, to see which program runs it [bytes]."""


def _check_first_line(path: str) -> None:
    """Raise OSError for a script that does not say what runs it, or a wrong name."""
    head = b""
    with contextlib.suppress(OSError), Path(path).open("rb") as file:
        head = file.read(_BEGINNING)
    line = head.partition(b"\n")[0].decode(errors="replace")
    if not line.startswith("#!"):
        if head and b"\0" not in head:
            raise OSError(
                f"{path} is text whose first line does not say which program runs it, "
                "as #!/bin/sh does"
            )
        return
    name = re.split("[ \t]", line.removeprefix("#!").strip(" \t"))[0]
    if name and not Path(name).exists():
        raise FileNotFoundError(
            f"{path} is to be run by {name!r}, as its first line says, which is not "
            "there"
        )


def program(name: str, folder: str) -> str:
    """Return the path of a program, of ``python`` or ``ros2:package/executable``."""
    if name in _PYTHON:
        return sys.executable
    if name.startswith("ros2:"):
        return _ros2_executable(*name.removeprefix("ros2:").split("/", 1))
    beside = Path(folder, name).absolute()  # the `python` of a venv is a link
    path = shutil.which(str(beside)) if "/" in name else shutil.which(name)
    if path is None and "/" in name and beside.is_file():
        raise PermissionError(f"{beside} may not be executed: see `chmod +x`")
    if path is None:
        where = f"as {beside}" if "/" in name else "on the PATH"
        raise FileNotFoundError(f"there is no such program {where}")
    return path


def _ros2_executable(package: str, name: str) -> str:
    """Return where a package has an executable; FileNotFoundError: what is there."""
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if p]
    folders = [Path(prefix, "lib", package) for prefix in prefixes]
    found = next((p for f in folders if (p := shutil.which(str(f / name)))), None)
    if found or (found := shutil.which(name)):
        return found
    where = ", ".join(map(str, folders)) or (
        "no folder, for AMENT_PREFIX_PATH is empty: source the setup.bash of ROS 2 "
        "where the agent is started"
    )
    there = sorted({p.name for f in folders if f.is_dir() for p in f.iterdir()})
    has = f"; package '{package}' has {listed(there)}" if there else ""
    raise FileNotFoundError(
        f"there is no '{name}' of package '{package}', nor on the PATH; looked in "
        f"{where}{did_you_mean(name, there)}{has}"
    )


def die_with_parent() -> None:
    """For `preexec_fn`: let this process be killed when its parent thread ends."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _before_command() -> None:
    die_with_parent()
    # the container ignores Ctrl-C; what it starts may want it
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def freeze_fenced(runners: Iterable[Runner]) -> None:
    """Stop the processes of those whose lease has ended; let the others go on."""
    for runner in runners:
        command = runner.component
        is_leased = runner.lease is not None and runner.life_cycle.is_at_work
        if is_leased and isinstance(command, CommandLine):
            command.freeze(is_frozen=runner.is_fenced)
