"""Tasks of a running robot as leaves of behaviour trees: py_trees, an extra."""

from __future__ import annotations

import time

from poise.errors import PoiseError, RunError, UsageError
from poise.manage.tasks.task_reports import TaskReport
from poise.session.running_robots.running import Running, connect

try:
    from py_trees.behaviour import Behaviour
    from py_trees.common import Status
except ImportError as error:
    raise UsageError(
        f"poise.tasks needs py_trees: pip install 'poise[py_trees]' ({error})"
    ) from error

__all__ = ["Act"]

PATIENCE = 10.0
"""A leaf fails when no manager has told how its task is for this time [s]."""


class Act(Behaviour):
    """A leaf that does a task of a robot, which another process keeps up.

    It starts the task at its first tick, and is running until that is over: a success
    when the task is done, a failure when it is given up, cancelled by others, cannot be
    started, or no manager has told of it for 10 s; `feedback_message` says why. A
    tree that turns to another branch meanwhile cancels the task. Every tick asks the
    robot's manager once.

    `task`: its name in the robot file.
    `robot`: the robot, or its name; None: the only one that runs on this computer.
    `priority`: that of the task; None: as in the robot file.
    `name`: what the leaf is called; empty: like the task.
    """

    def __init__(
        self,
        task: str,
        robot: Running | str | None = None,
        *,
        priority: int | None = None,
        name: str = "",
    ) -> None:
        super().__init__(name or task)
        self._task = task
        self._robot = robot
        self._priority = priority
        self._report: TaskReport | None = None
        self._told = 0.0

    def setup(self, **_: object) -> None:
        """Connect with the robot; raise `UsageError` when it does not run."""
        if not isinstance(self._robot, Running):
            self._robot = connect(self._robot)

    def initialise(self) -> None:
        """Start the task."""
        self._report, self.feedback_message = None, ""
        try:
            self.setup()
            self._report = self._running.tasks.start(self._task, self._priority)
            self._told = time.monotonic()
        except PoiseError as error:
            self.feedback_message = str(error)

    def update(self) -> Status:
        """Return how the task is."""
        if self._report is None:
            return Status.FAILURE
        try:
            self._report = self._now(self._report)
            self._told = time.monotonic()
        except RunError as error:  # the robot goes on, and may get the next manager
            self.feedback_message = f"{self._report.state} when last heard of: {error}"
            is_lost = time.monotonic() - self._told > PATIENCE
            return Status.FAILURE if is_lost else Status.RUNNING
        except PoiseError as error:
            self.feedback_message = str(error)
            return Status.FAILURE
        state, why = self._report.state, self._report.why
        self.feedback_message = f"{state}: {why}" if why else state
        if state in {"failed", "cancelled"}:
            return Status.FAILURE
        return Status.SUCCESS if state == "done" else Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        """Cancel the task when the tree turns to something else."""
        if new_status is not Status.INVALID or self.status is not Status.RUNNING:
            return
        try:
            self._running.tasks.cancel(self._task)
        except PoiseError as error:  # it is over, or the robot is
            self.feedback_message = str(error)

    @property
    def _running(self) -> Running:
        assert isinstance(self._robot, Running)  # noqa: S101, since it was set up
        return self._robot

    def _now(self, before: TaskReport) -> TaskReport:
        """Return how the task is that this leaf started."""
        for each in self._running.tasks.started():
            if (each.name, each.began) == (before.name, before.began):
                return each
        raise UsageError(f"task '{self._task}' is over, and was started again")
