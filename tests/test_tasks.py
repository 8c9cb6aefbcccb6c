"""Tasks are leaves of behaviour trees."""

from __future__ import annotations

from typing import Any, cast

import pytest
from msgspec.structs import replace

from poise.errors import RunError, UsageError
from poise.manage.tasks.task_reports import TaskReport, TaskState
from poise.session.running_robots.running import Running, RunningTasks

py_trees = pytest.importorskip("py_trees", reason="the extra `py_trees` is missing")
Status = py_trees.common.Status


class FakeTasks:
    """Tasks that are as a test says."""

    def __init__(self) -> None:
        self.reports: list[TaskReport] = []
        self.cancelled: list[str] = []
        self.trouble: Exception | None = None

    def start(self, task: str, priority: int | None = None) -> TaskReport:
        if self.trouble:
            raise self.trouble
        report = TaskReport(
            name=task,
            state="going",
            priority=priority or 0,
            why="",
            began=float(len(self.reports)),
            since=0.0,
        )
        self.reports.append(report)
        return report

    def started(self) -> tuple[TaskReport, ...]:
        if self.trouble:
            raise self.trouble
        return tuple(self.reports)

    def cancel(self, task: str) -> None:
        self.cancelled.append(task)

    def end(self, state: TaskState, why: str = "") -> None:
        self.reports[-1] = replace(self.reports[-1], state=state, why=why)


class FakeRunning(Running):
    """A robot with such tasks."""

    def __init__(self) -> None:
        super().__init__("butler")
        self.fake = FakeTasks()

    @property
    def tasks(self) -> RunningTasks:
        return cast("RunningTasks", self.fake)


@pytest.fixture
def robot() -> FakeRunning:
    return FakeRunning()


def act(robot: Running, *names: str) -> Any:
    from poise.tasks import Act  # noqa: PLC0415, py_trees may be missing

    leaves = [Act(name, robot, priority=3) for name in names]
    if len(leaves) == 1:
        return leaves[0]
    return py_trees.composites.Sequence("all", memory=True, children=leaves)


def test_a_leaf_starts_its_task_and_succeeds_with_it(robot: FakeRunning) -> None:
    leaf = act(robot, "fetch")
    leaf.setup()
    for _ in range(2):
        leaf.tick_once()
        assert leaf.status is Status.RUNNING
    assert [(r.name, r.priority) for r in robot.fake.reports] == [("fetch", 3)]
    robot.fake.end("done")
    leaf.tick_once()
    assert (leaf.status, leaf.feedback_message) == (Status.SUCCESS, "done")
    assert not robot.fake.cancelled


@pytest.mark.parametrize("state", ["failed", "cancelled"])
def test_a_leaf_fails_with_its_task_and_says_why(
    robot: FakeRunning, state: TaskState
) -> None:
    leaf = act(robot, "fetch")
    leaf.tick_once()
    robot.fake.end(state, "30 s are over")
    leaf.tick_once()
    assert leaf.status is Status.FAILURE
    assert leaf.feedback_message == f"{state}: 30 s are over"


def test_a_task_that_waits_is_running(robot: FakeRunning) -> None:
    leaf = act(robot, "fetch")
    leaf.tick_once()
    robot.fake.end("waiting", "task 'wave' uses the device 'arm'")
    leaf.tick_once()
    assert leaf.status is Status.RUNNING
    assert leaf.feedback_message == "waiting: task 'wave' uses the device 'arm'"


def test_a_tree_does_one_task_after_the_other(robot: FakeRunning) -> None:
    tree = act(robot, "fetch", "wave")
    tree.tick_once()
    robot.fake.end("done")
    tree.tick_once()
    assert [r.name for r in robot.fake.reports] == ["fetch", "wave"]
    assert tree.status is Status.RUNNING
    robot.fake.end("done")
    tree.tick_once()
    assert tree.status is Status.SUCCESS


def test_what_the_tree_leaves_is_cancelled(robot: FakeRunning) -> None:
    leaf = act(robot, "fetch")
    leaf.tick_once()
    leaf.stop(Status.INVALID)
    assert robot.fake.cancelled == ["fetch"]
    leaf.stop(Status.INVALID)
    assert robot.fake.cancelled == ["fetch"]


def test_a_task_that_cannot_start_is_a_failure(robot: FakeRunning) -> None:
    robot.fake.trouble = UsageError("there is no task 'fetch'")
    leaf = act(robot, "fetch")
    leaf.tick_once()
    assert leaf.status is Status.FAILURE
    assert leaf.feedback_message == "there is no task 'fetch'"


def test_a_leaf_waits_for_the_next_manager_but_not_for_ever(
    robot: FakeRunning, monkeypatch: pytest.MonkeyPatch
) -> None:
    leaf = act(robot, "fetch")
    leaf.tick_once()
    robot.fake.trouble = RunError("no answer")
    leaf.tick_once()
    assert leaf.status is Status.RUNNING
    assert leaf.feedback_message == "going when last heard of: no answer"
    robot.fake.trouble = None
    leaf.tick_once()
    assert (leaf.status, leaf.feedback_message) == (Status.RUNNING, "going")
    monkeypatch.setattr("poise.tasks.PATIENCE", 0.0)
    robot.fake.trouble = RunError("no answer")
    leaf.tick_once()
    assert leaf.status is Status.FAILURE


def test_a_task_that_others_started_again_is_not_its_own(robot: FakeRunning) -> None:
    leaf = act(robot, "fetch")
    leaf.tick_once()
    robot.fake.reports[0] = replace(robot.fake.reports[0], began=99.0)
    leaf.tick_once()
    assert leaf.status is Status.FAILURE
    assert "was started again" in leaf.feedback_message
