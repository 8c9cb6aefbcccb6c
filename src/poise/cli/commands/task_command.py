"""`poise task`: the tasks of a running robot."""

from __future__ import annotations

from typing import Annotated

import typer

from poise.cli.commands.running_robot_command import Robot
from poise.cli.options import AsJson, print_json, running
from poise.manage.tasks.concurrent_tasks import TaskReport
from poise.session.render.printable import console_to
from poise.session.render.tables import action_lines, task_lines, task_table
from poise.session.running_robots.running import Running

Name = Annotated[
    str,
    typer.Argument(
        help="The task, as in the robot file.", autocompletion=running("tasks")
    ),
]


def start_command(
    task: Name,
    priority: Annotated[
        int | None, typer.Option(help="Instead of the robot file's.")
    ] = None,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Start a task of a running robot, beside those that run.

    Tasks that need the same device or the same room run by priority: the others wait.

    Example: poise task start fetch
    """
    _show(Running(robot).tasks.start(task, priority), as_json=as_json)


def pause_command(task: Name, robot: Robot = None, as_json: AsJson = False) -> None:
    """Let a task rest: its components keep their state, and use no CPU.

    Example: poise task pause fetch
    """
    _show(Running(robot).tasks.pause(task), as_json=as_json)


def resume_command(task: Name, robot: Robot = None, as_json: AsJson = False) -> None:
    """Let a paused task go on.

    Example: poise task resume fetch
    """
    _show(Running(robot).tasks.resume(task), as_json=as_json)


def cancel_command(task: Name, robot: Robot = None, as_json: AsJson = False) -> None:
    """End a task.

    Example: poise task cancel fetch
    """
    _show(Running(robot).tasks.cancel(task), as_json=as_json)


def list_command(robot: Robot = None, as_json: AsJson = False) -> None:
    """List the tasks of a running robot that were started.

    Example: poise task list
    """
    tasks = Running(robot).tasks.started()
    print_json(tasks) if as_json else console_to().print(task_table(tasks))


def show_command(task: Name, robot: Robot = None, as_json: AsJson = False) -> None:
    """Show a task of a running robot: its actions, and what they use.

    Example: poise task show fetch
    """
    _show(Running(robot).tasks.show(task), as_json=as_json)


def _show(report: TaskReport, *, as_json: bool) -> None:
    if as_json:
        print_json(report)
        return
    console = console_to()
    for line in (*task_lines([report]), *action_lines(report)):
        console.print(line)


task_command = list_command
