"""The exit code of a command that starts a task says how that went."""

from __future__ import annotations

import pytest
import typer

from poise.cli import running_robot_command
from poise.cli.running_robot_command import resume_command, start_command
from poise.manage.tasks.task_reports import TaskReport, TaskState


class FakeRunning:
    """A robot whose tasks are all in one state."""

    def __init__(self, state: TaskState) -> None:
        self.tasks = self
        self._state = state

    def start(self, task: str, _: int | None = None) -> TaskReport:
        return TaskReport(
            name=task, state=self._state, priority=0, why="", began=0.0, since=0.0
        )

    resume = start


@pytest.mark.parametrize("state", ["going", "waiting", "failed"])
def test_a_task_that_fails_at_once_is_an_error(
    state: TaskState,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    running = FakeRunning(state)
    monkeypatch.setattr(running_robot_command, "Running", lambda _: running)
    for command in (start_command, resume_command):
        try:
            command("fetch")
            code = 0
        except typer.Exit as ended:
            code = ended.exit_code
        assert code == (state == "failed")
        assert f"task 'fetch' is {state}" in capsys.readouterr().out
