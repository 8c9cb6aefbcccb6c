"""Starts a robot's components on its computers, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct

from poise import threads
from poise.clock import SystemClock
from poise.errors import RobotError, RunError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import containers_left
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.model.robot import Robot
from poise.runtime.hosting.command_line import die_with_parent, runnable
from poise.session import Check, Say, log, nothing
from poise.session.folders import scratch_folder
from poise.session.launch.computers import Computers, computers_of
from poise.units import counted
from poise.waker import wait_readable
from poise.wire.records.request_records import Election
from poise.wire.records.status_records import SAMPLE_EVERY, AgentSample
from poise.wire.robots_here import forget, note, path_of

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
        line = self._last.decode(errors="replace")
        if not line:
            raise RunError("the simulator ended without a result")
        try:
            found = json.loads(line)
        except json.JSONDecodeError:
            found = None
        if not isinstance(found, dict):
            raise RunError(f"the simulator's last line is no JSON object: {line!r}")
        return found

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
    command = robot.simulator.command
    try:
        process = subprocess.Popen(  # noqa: S603, the robot file's own command
            runnable(command, robot.folder or "."),
            cwd=robot.folder or None,
            env={**os.environ, "POISE_RUN": str(folder)},
            stdin=subprocess.PIPE,  # its end tells the world that we are gone
            stdout=subprocess.PIPE,
            start_new_session=True,
            # safe beside other threads: it takes no lock that one of them may hold
            preexec_fn=die_with_parent,  # noqa: PLW1509
        )
    except OSError as error:
        raise RobotError(f"simulator '{command[0]}' cannot start: {error}") from error
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


_STEP = 0.2
MISSING_LIMIT = 2.0
"""The agents of a robot that is to be taken over are there within this time [s], or
their computers are lost."""
AGENT_LIMIT = 20.0
"""All agents are there within this time [s]."""


class Started(Struct, frozen=True):
    """A robot that runs, with what it runs on."""

    live: LiveRobot
    computers: Computers
    world: SimulatorProcess | None

    def watch(
        self,
        seconds: float,
        meanwhile: Callable[[float], object] = lambda _: None,
        is_over: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Let it run for `seconds`; return whether the simulated world ended first."""
        last, end = time.monotonic(), time.monotonic() + seconds
        while (left := end - last) > 0:
            self.live.watch(min(left, _STEP))
            self.computers.poll()
            now = time.monotonic()
            meanwhile(now - last)
            last = now
            if is_over():
                return False
            if self.world is not None and self.world.has_ended():
                return True
        return False


class Sampling(Struct, frozen=True):
    """What takes samples, on another thread and without blocking, how often [s]."""

    take: Callable[[AgentSample], object] | None = None
    every: float = SAMPLE_EVERY
    weigh: bool = False


@contextlib.contextmanager
def started(  # noqa: PLR0913 - each is a choice of the caller
    robot: Robot,
    placement: Mapping[str, str],
    journal: Journal,
    say: Say,
    sampling: Sampling | None = None,
    check: Check = nothing,
    *,
    use_kept: bool = False,
    begin: Callable[[LiveRobot], object] | None = None,
    tasks: bytes = b"",
    election: Election | None = None,
    found: Computers | None = None,
) -> Iterator[Started]:
    """Start a robot's components on its computers; stop and remove all afterwards.

    `tasks`: what it is to do, as in `Desired`.
    `election`: how its managers follow each other; None: they do not.
    `found`: its computers, which are up already; None: they are found or emulated.
    """
    _check_runnable(robot, placement)
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(scratch_folder("poise-run-"))
        look = sampling or Sampling()
        at_work = threading.Event()

        def take(sample: AgentSample) -> None:
            if look.take is not None and at_work.is_set():
                look.take(sample)

        computers = found or stack.enter_context(
            computers_of(
                robot, folder / "computers", say, look.every, use_kept=use_kept
            )
        )
        world = stack.enter_context(world_of(robot, folder, check))
        agents = stack.enter_context(
            Agents(
                robot.name,
                computers.endpoints,
                SystemClock(),
                take if look.take else None,
                is_leased=computers.outlive_process,
                election=election,
                keys=computers.addresses.credentials(),
                control=str(path_of(robot.name)),
            )
        )

        def look_around() -> None:
            check()
            computers.raise_if_ended()

        if begin is None or not agents.wait_at_work(MISSING_LIMIT, look_around):
            agents.wait_alive(
                computers.endpoints, AGENT_LIMIT, look_around, computers.why_silent
            )
        live = LiveRobot(
            robot, placement, agents, journal, str(folder), weigh=look.weigh
        )
        live.begin_with(tasks)
        if begin is None:
            say(f"starting {counted(len(placement), 'component')}")
        if computers.outlive_process:
            try:
                note(computers.addresses)
            except RunError as error:  # it says what is harder now
                say(str(error))
            stack.callback(_forget_if_ended, robot.name, agents, computers.endpoints)
        stack.enter_context(_running(live, check, begin or LiveRobot.start))
        stack.callback(at_work.clear)
        at_work.set()
        yield Started(live, computers, world)


def _forget_if_ended(robot: str, agents: Agents, computers: Iterable[str]) -> None:
    """Forget where the agents are, unless something may still run there."""
    if not containers_left(agents.statuses(), computers):
        try:
            forget(robot)
        except OSError as error:  # commands ask the agents, which run nothing
            log.warning("the note of where its agents were stays: %s", error)


def _check_runnable(robot: Robot, placed: Collection[str]) -> None:
    """Raise RobotError when components are described for planning only."""
    found = (component for component in robot.components() if component.name in placed)
    if nothing := [c.name for c in found if not (c.implementation or c.command)]:
        raise RobotError(
            f"components without `implementation` or `command`: {', '.join(nothing)}. "
            "They can be planned, but not run"
        )


@contextlib.contextmanager
def _running(
    live: LiveRobot, check: Check, begin: Callable[[LiveRobot], object]
) -> Iterator[None]:
    try:
        live.check = check
        begin(live)
        yield
    except BaseException:  # Ctrl-C, too, must leave nothing running
        if live.has_taken_over and not live.is_over.is_set():
            live.leave()  # a robot at work goes on, whatever becomes of this manager
        # the first error is the one to raise; what it leaves on real computers is said
        try:
            stop(live)
        except RunError as left:
            log.warning("%s", left)
        raise
    stop(live)
