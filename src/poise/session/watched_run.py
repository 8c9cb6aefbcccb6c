"""Lets people look at a run: `poise status`, `top`, `dashboard`, `echo`, `log`."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future

from msgspec.structs import replace

from poise.errors import PoiseError
from poise.manage.control_socket.looks import look, status_of
from poise.manage.control_socket.records import (
    Command,
    Refusal,
    Result,
    RobotStatus,
    StopCommand,
    StopReport,
)
from poise.manage.control_socket.server import ControlServer
from poise.manage.deploy.running_components import Run
from poise.manage.observe.deviations import find_deviations
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.recording import Recording
from poise.manage.tasks.task_manager import TaskManager
from poise.model.robot import Robot
from poise.session.callbacks import Say
from poise.session.profiling.stored_profiles import read_profile


class WatchedRun:
    """Answers those who look at a run; of commands it only takes the stop."""

    def __init__(self, robot: Robot) -> None:
        emulated = all(computer.address is None for computer in robot.computers)
        self.samples = Recording()
        """What agents say of what is used: to be filled."""
        self._estimates = Estimates(robot, read_profile(robot), emulated=emulated)
        self._stops: list[Future[Result | Refusal]] = []
        self._is_stopped = threading.Event()
        self._server: ControlServer | None = None

    @contextlib.contextmanager
    def served(self, robot: str, say: Say) -> Iterator[bool]:
        """Have a control socket meanwhile; yield whether there is one."""
        with contextlib.ExitStack() as stack:
            try:
                self._server = stack.enter_context(ControlServer(robot))
            except PoiseError as error:
                say(f"this run cannot be watched: {error}")
            stack.callback(self._answer_stops)
            yield self._server is not None

    def begin(self, run: Run, tasks: TaskManager) -> None:
        """Answer from now on."""

        def status() -> RobotStatus:
            found = status_of(run, tasks.reports, self._estimates)
            settled = set(run.wanted) & set(run.placed.values())
            deviations = find_deviations(
                settled, set(run.wanted), run.layout, run.current(), time.time()
            )
            return replace(found, deviations=tuple(deviations))

        def submit(command: Command) -> Future[Result | Refusal]:
            future: Future[Result | Refusal] = Future()
            if isinstance(command, StopCommand):
                self._stops.append(future)
                self._is_stopped.set()
            else:
                only_up = "`poise run` takes no such command: `poise up` does"
                seen = look(run, status, command)
                future.set_result(Refusal(only_up) if seen is None else seen)
            return future

        if self._server is not None:
            self._server.start(submit)

    def look(self) -> None:
        """Take samples; raise KeyboardInterrupt when somebody has stopped the run."""
        for sample in self.samples.take():
            self._estimates.take(sample)
        if self._is_stopped.is_set():
            raise KeyboardInterrupt

    def _answer_stops(self) -> None:
        for future in self._stops:
            if future.set_running_or_notify_cancel():
                future.set_result(StopReport())
