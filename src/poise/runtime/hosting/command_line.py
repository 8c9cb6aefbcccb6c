"""A component that is any executable: one process, which its container watches.

It has the environment of the agent and, added to it:

- ``POISE_COMPONENT``: its name;
- ``POISE_PARAMETERS``: its parameters, a JSON object;
- ``POISE_DEVICE_<NAME>``: the path of each of its devices; the name is in capitals,
  with ``_`` for every ``-``.

Poise does not wire it: what it says to others, it says by its own means.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from poise.runtime._calls import ComponentCounters
from poise.runtime.waker import wait_readable
from poise.wire.records.deployment import Aim, ComponentSpec, ComponentStatus, State

_KILL_LIMIT = 0.5
_PR_SET_PDEATHSIG = 1
_prctl = ctypes.CDLL(None).prctl


class Command:
    """A command-line component.

    It is inactive when its program was found, active while its process runs. All
    methods are for the container's own thread.

    Parameters
    ----------
    spec
        Its name, command, parameters and devices.
    folder
        Where it is run, and where its program is looked for first.
    """

    def __init__(self, spec: ComponentSpec, folder: str) -> None:
        self.spec = spec
        self._folder = folder or "."
        self._state: State = "unconfigured"
        self._error = ""
        self._process: subprocess.Popen[bytes] | None = None
        self._goal: Aim = "inactive"
        self._was_asked_to_end = False
        self._pidfd = -1
        self._began_within = 0.0
        self.counters = ComponentCounters()

    def aim(self, goal: Aim) -> None:
        """Bring it to `goal` at once, but do not wait for its process to end.

        One that is to be active again before it ended begins anew when it did.
        """
        if self._state in {"failed", "finalized"}:
            return
        self._goal = goal
        try:
            if self._state == "unconfigured":
                self._argv()
                self._state = "inactive"
            if goal == "active" and self._process is None:
                began = time.monotonic()
                self._process = self._start()
                self._began_within = time.monotonic() - began
                self._pidfd = os.pidfd_open(self._process.pid)
                self.counters.watch(self._process.pid)
                self._state = "active"
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            self._error = f"'{self.spec.command[0]}' cannot be started: {error}"
            self._state = "failed"
        if goal != "active" and self._process is not None:
            self._was_asked_to_end = True
            self._signal(signal.SIGTERM)
        if goal == "finalized" and self._process is None:
            self._state = "finalized"

    def watched(self) -> Sequence[int]:
        """Return the descriptors that become readable when its process ends."""
        return () if self._process is None else (self._pidfd,)

    def raise_if_ended(self) -> None:
        """Raise ChildProcessError when its process ended, unless it was asked to."""
        if self._process is None or not wait_readable([self._pidfd], 0.0):
            return
        code = self._reap()
        if self._was_asked_to_end:
            self._was_asked_to_end = False
            self._state = "inactive"
            self.aim(self._goal)
            return
        how = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        self._error = f"its command ended with {how}"
        raise ChildProcessError(f"component '{self.spec.name}': {self._error}")

    def wait_ended(self, limit: float) -> bool:
        """Wait up to `limit` [s] for its process, then kill it; whether it is gone."""
        if self._process is not None and not wait_readable([self._pidfd], limit):
            self._signal(signal.SIGKILL)
            wait_readable([self._pidfd], _KILL_LIMIT)
        return self.has_ended()

    def has_ended(self) -> bool:
        """Return at once whether its process is gone."""
        if self._process is not None and wait_readable([self._pidfd], 0.0):
            self._reap()
            self._state = "finalized"
        return self._process is None

    def status(self, cpu: float | None = None) -> ComponentStatus:
        """Return what is known of it now; `cpu` as for components in Python [s]."""
        return ComponentStatus(
            name=self.spec.name,
            epoch=self.spec.epoch,
            state=self._state,
            error=self._error,
            errors=1 if self._error else 0,
            start=self._began_within,
            cpu=self.counters.cpu() if cpu is None else cpu,
        )

    def _argv(self) -> list[str]:
        return [program(self.spec.command[0], self._folder), *self.spec.command[1:]]

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(  # noqa: S603, the robot file's own command
            self._argv(),
            cwd=self._folder,
            env={**os.environ, **environment(self.spec)},
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            # safe beside other threads: it takes no lock that one of them may hold
            preexec_fn=_before_command,  # noqa: PLW1509
        )

    def _signal(self, number: signal.Signals) -> None:
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)

    def _reap(self) -> int:
        """Take its exit code, and whatever it started along."""
        assert self._process is not None  # noqa: S101, the callers looked
        self._signal(signal.SIGKILL)
        code = self._process.wait(_KILL_LIMIT)
        os.close(self._pidfd)
        self.counters.end()
        self._process = None
        return code


def environment(spec: ComponentSpec) -> Mapping[str, str]:
    """Return what a command-line component finds in its environment."""
    devices = {
        f"POISE_DEVICE_{name.upper().replace('-', '_')}": path
        for name, path in spec.devices.items()
    }
    return {
        "POISE_COMPONENT": spec.name,
        "POISE_PARAMETERS": msgspec.json.encode(spec.parameters).decode(),
        **devices,
    }


def program(name: str, folder: str) -> str:
    """Return the program's path; ``python`` is the one that Poise runs in."""
    if name in {"python", "python3"}:
        return sys.executable
    beside = Path(folder, name).resolve()
    found = shutil.which(str(beside)) if "/" in name else shutil.which(name)
    if found is None:
        where = f"as {beside}" if "/" in name else "on the PATH"
        raise FileNotFoundError(f"there is no such program {where}")
    return found


def die_with_parent() -> None:
    """Let this process be killed when the thread that forked it ends.

    For `preexec_fn`: no process survives its keeper, even one that was killed.
    """
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _before_command() -> None:
    die_with_parent()
    # the container ignores Ctrl-C; what it starts may want it
    signal.signal(signal.SIGINT, signal.SIG_DFL)
