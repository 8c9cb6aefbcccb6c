"""Keeps a robot up in the background, by a process that outlives this one."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from poise.emulate import set_for
from poise.errors import PoiseError, RunError, signal_name
from poise.model.robot import Robot
from poise.session import Check, Say
from poise.session.launch.background_log import log_of
from poise.session.running_robots.running import Running
from poise.wire.robots_here import is_alive, path_of

_LOOK_EVERY = 0.05
_LIMIT = 300.0
"""Computers and robots are up within this time, or something is wrong [s]."""
_END_LIMIT = 30.0
"""A process that is not wanted any more ends within this time [s]."""


class DetachedFailure(RunError):
    """A process in the background has ended, with an exit code."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def up_detached(
    robot: Robot,
    file: Path,
    words: Sequence[str],
    say: Say,
    check: Check,
    *,
    arguments: Sequence[str] = (),
) -> None:
    """Run `poise WORDS` in the background, on computers that outlive it, and say so."""
    keeps = ""
    with contextlib.ExitStack() as undo:
        if robot.is_emulated and set_for(robot) is None:
            log = log_of(f"{robot.name}.computers")
            size = log.stat().st_size
            values = [f"--set={argument}" for argument in arguments]
            keeper = _started(["emulate", str(file), *values], log)
            undo.callback(_end_unused, robot.name, keeper)
            _wait(keeper, log, size, lambda: set_for(robot) is not None, check)
            keeps = (
                f"its emulated computers stay up until `poise emulate stop`; log: {log}"
            )
            if kept := set_for(robot):
                for sentence in kept.state().without:
                    say(f"  without {sentence}")
        log = log_of(robot.name)
        size = log.stat().st_size
        process = _started(words, log)
        undo.callback(_end, process)
        _wait(process, log, size, lambda: _manages(process.pid, robot.name), check)
        undo.pop_all()
    if keeps:  # not when this failed, or was interrupted
        say(keeps)
    say(
        f"robot '{robot.name}' is up, managed by process {process.pid}; `poise stop` "
        f"ends it; log: {log}"
    )


def _started(words: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
    with log.open("ab") as output:
        return subprocess.Popen(  # noqa: S603, Poise itself
            [sys.executable, "-m", "poise", *words],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def _wait(
    process: subprocess.Popen[bytes],
    log: Path,
    size: int,
    is_done: Callable[[], bool],
    check: Check,
) -> None:
    """Wait until it is done or has ended; the log had `size` bytes before."""
    until = time.monotonic() + _LIMIT
    while not is_done():
        check()
        if time.monotonic() > until:
            text = f"process {process.pid} has not brought all up within {_LIMIT:g} s"
            raise RunError(f"{text}, and is ended; log: {log}")
        code = process.poll()
        if code is not None:
            said = log.read_bytes()[size:].decode(errors="replace").strip()
            said = said or _why_silent(process.pid, code, log)
            raise DetachedFailure(f"{said}\n(log: {log})", code if code > 0 else 1)
        time.sleep(_LOOK_EVERY)


def _why_silent(process: int, code: int, log: Path) -> str:
    """Return what is known of a process that ended, and left nothing in its log."""
    ended = f"process {process} ended "
    ended += f"with exit code {code}" if code >= 0 else f"by {signal_name(-code)}"
    try:
        with log.open("ab") as file:
            file.write(b"\n")
    except OSError as error:
        return (
            f"{ended}; why is not known, as its log cannot be written: "
            f"{error.strerror}. Make room, or choose another folder by XDG_STATE_HOME"
        )
    return f"{ended}, and said nothing"


def _manages(process: int, robot: str) -> bool:
    try:
        status = Running(robot).status()
    except PoiseError:  # it is still starting
        return False
    # agents name it as soon as it has claimed them
    return not status.by_agents and status.manager.pid == process


def _end_unused(robot: str, keeper: subprocess.Popen[bytes]) -> None:
    """End what keeps a robot's computers, unless another manager came first."""
    if not is_alive(path_of(robot)):
        _end(keeper)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(_END_LIMIT)
        except subprocess.TimeoutExpired:
            text = f"process {process.pid} still runs {_END_LIMIT:g} s after SIGTERM"
            raise RunError(text) from None
