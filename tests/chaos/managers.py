"""The managers of a robot that is broken at random: programs of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from poise.emulate import EmulatedSet

END_LIMIT = 60.0
"""A manager that is asked to end has ended within this time [s]."""
_TAKEN_OVER = 3
"""The exit code of a manager that another one replaced."""


class Managers:
    """The manager of a robot, and for a while a second one.

    Parameters
    ----------
    file
        The robot's file.
    folder
        For what they print, and their journals.

    Attributes
    ----------
    first
        The manager that runs beside the emulated computers.
    second
        One that runs on a computer that is cut off, or did last; None: none did.
    """

    def __init__(self, file: Path, folder: Path) -> None:
        self._file = file
        self._folder = folder
        self.first = self._start()
        self.second: subprocess.Popen[bytes] | None = None

    def kill(self) -> None:
        """Kill the first one."""
        self.first.kill()
        self.first.wait(END_LIMIT)

    def was_taken_over(self) -> bool:
        """Return whether the first one gave way to the second, which is killed now."""
        second = self.second
        is_over = second is not None and second.poll() is not None
        return is_over and self.first.poll() == _TAKEN_OVER

    def restart(self) -> None:
        """Start the first one again; it takes over what runs."""
        self.first = self._start()

    def start_second(
        self, computers: EmulatedSet, computer: str, *, forced: bool
    ) -> None:
        """Start a second one on a computer; it does not see the first one's socket.

        Parameters
        ----------
        forced
            Whether it takes the robot over though another manager may be alive.
        """
        there = computers.computers[computer]
        env = {**os.environ, "XDG_RUNTIME_DIR": str(there.folder)}
        argv = self._argv("second.sqlite") + ["--take-over"] * forced
        with (self._folder / "second.log").open("ab") as log:
            self.second = there.popen(argv, env=env, stdout=log, stderr=log)

    def kill_second(self) -> None:
        """Kill the second one; repeating it is harmless."""
        if self.second is not None:
            self.second.kill()
            self.second.wait(END_LIMIT)

    def end(self) -> str:
        """End the robot; return what was wrong with that, or nothing."""
        self.kill_second()
        self.first.send_signal(signal.SIGTERM)
        try:
            self.first.wait(END_LIMIT)
        except subprocess.TimeoutExpired:
            self.kill()
            return f"the manager did not end within {END_LIMIT:g} s of SIGTERM"
        return ""

    def _start(self) -> subprocess.Popen[bytes]:
        with (self._folder / "manager.log").open("ab") as log:
            argv = self._argv("journal.jsonl")
            return subprocess.Popen(argv, stdout=log, stderr=log)

    def _argv(self, journal: str) -> list[str]:
        argv = [sys.executable, "-m", "poise", "up", str(self._file)]
        return [*argv, "--journal", str(self._folder / journal)]
