"""The tasks of a running robot, to start, to command and to wait for."""

from __future__ import annotations

import time
from typing import Literal

from poise.errors import Timeout, UsageError
from poise.manage.control_socket.client import ask
from poise.manage.control_socket.records import (
    RobotStatus,
    StatusCommand,
    TaskCommand,
    TaskDone,
)
from poise.manage.tasks.progress import OVER
from poise.manage.tasks.report import TaskReport

_LOOK_EVERY = 0.05


class RunningTasks:
    """The tasks of a running robot.

    Every method raises `UsageError` when the robot's manager refuses, `RunError` when
    it gives no answer, and `NoManager` when the robot goes on without one.
    """

    def __init__(self, robot: str | None) -> None:
        self._robot = robot

    def start(self, task: str, priority: int | None = None) -> TaskReport:
        """Start a task; it runs beside others, or waits for them.

        Parameters
        ----------
        priority
            None: that of the robot file.
        """
        return self._do("start", task, priority)

    def pause(self, task: str) -> TaskReport:
        """Let a task rest until it is resumed; its components keep their state."""
        return self._do("pause", task)

    def resume(self, task: str) -> TaskReport:
        """Let a paused task go on."""
        return self._do("resume", task)

    def cancel(self, task: str) -> TaskReport:
        """End a task."""
        return self._do("cancel", task)

    def started(self) -> tuple[TaskReport, ...]:
        """Return the tasks that were started, the last ones that are over, too."""
        return ask(self._robot, StatusCommand(), RobotStatus).tasks

    def show(self, task: str) -> TaskReport:
        """Return a task that was started; of several of its name the last."""
        tasks = self.started()
        for each in reversed(tasks):
            if each.name == task:
                return each
        names = ", ".join(dict.fromkeys(each.name for each in tasks)) or "none"
        raise UsageError(f"task '{task}' was not started (started were: {names})")

    def wait(self, task: str, seconds: float) -> TaskReport:
        """Wait until a task is over; return how it ended.

        Raises
        ------
        Timeout
            It was not within `seconds` [s].
        """
        until = time.monotonic() + seconds
        while (report := self.show(task)).state not in OVER:
            if time.monotonic() > until:
                raise Timeout(
                    f"task '{task}' is {report.state} after {seconds:g} s"
                    + (f": {report.why}" if report.why else "")
                )
            time.sleep(_LOOK_EVERY)
        return report

    def _do(
        self,
        verb: Literal["start", "pause", "resume", "cancel"],
        task: str,
        priority: int | None = None,
    ) -> TaskReport:
        return ask(self._robot, TaskCommand(verb, task, priority), TaskDone).report
