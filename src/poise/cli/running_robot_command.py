"""Commands to a running robot: `poise status`, `move`, `replace`, `stop`, `task`."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from rich.markup import escape

import poise
from poise import threads
from poise.cli.options import AsJson, busy, parse_option, running, show
from poise.errors import PoiseError, UsageError
from poise.manage.tasks.task_reports import TaskReport
from poise.session.render.printable import console_to
from poise.session.render.tables import (
    Outcome,
    action_lines,
    outcome_lines,
    task_lines,
    task_table,
    what_if_lines,
)
from poise.session.running_robots.running import NoManager, RolledBack, Running
from poise.units import SECONDS

TELL_EVERY = 1.0
"""How often it says what is under way [s]."""
_MOST_COST = 1e9
GOES_ON = "what has begun goes on (`poise status`, `poise journal`)"
_LAST_ANSWER = 15.0
"""What it asked last is answered, or refused, within this time [s]."""


@contextmanager
def telling_progress(running: Running, goes_on: str) -> Iterator[None]:
    """Say what migrations wait for, until the block ends; at Ctrl-C, what `goes_on`."""
    is_over, said = threading.Event(), list[str]()
    before = signal.getsignal(signal.SIGINT)

    def leave(number: int, frame: FrameType | None) -> None:
        why = f": {'; '.join(said)}" if said else ""
        os.write(2, f"not waiting any more; {goes_on}{why}\n".encode())
        if callable(before):
            before(number, frame)

    def tell() -> None:
        while not is_over.wait(TELL_EVERY):
            try:
                said[:] = running.status().under_way
            except PoiseError:  # the command itself says why
                return
            sys.stderr.writelines(f"{sentence}\n" for sentence in said)

    telling = threads.daemon(tell, "progress")
    telling.start()
    signal.signal(signal.SIGINT, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        is_over.set()
        # zenoh aborts a process that ends while another thread waits in it
        telling.join(_LAST_ANSWER)


Robot = Annotated[
    str | None,
    typer.Option(
        help="The robot's name, when several run here.",
        autocompletion=running("robots"),
    ),
]


def status_command(
    robot: Robot = None,
    file: Annotated[
        Path | None,
        typer.Option(help="Robot file: ask its agents, if no manager runs here."),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Also connectors, clocks, and containers.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show where a running robot's components are, and how they do.

    Of a robot without a manager it shows what its agents say; with --file also of one
    that was started from elsewhere. The exit code is 1 when anything is not as the
    robot file says, and 4 without a manager.

    Example: poise status
    """
    _check_one(file, robot)
    if file is None:
        status = Running(robot).status()
    else:
        status = poise.status_without_manager(poise.model.load(file))
    details = status.details() if everything else ()
    show(status, (*status.parts(), *details), as_json=as_json)
    if status.by_agents:
        raise typer.Exit(NoManager.exit_code)
    if status.deviations:
        raise typer.Exit(1)


def _check_one(file: Path | None, robot: str | None) -> None:
    if file is not None and robot is not None:
        raise UsageError(f"give --file {file} or --robot {robot}, not both")


def move_command(
    component: Annotated[
        str, typer.Argument(help="The component.", autocompletion=running("components"))
    ],
    computer: Annotated[
        str,
        typer.Argument(
            help="The computer to move it to.", autocompletion=running("computers")
        ),
    ],
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Move it even where it does not fit, or in spite of its layer.",
        ),
    ] = False,
    dry: Annotated[
        bool, typer.Option("--dry-run", help="Say what it would change; move nothing.")
    ] = False,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Move a component of a running robot to another computer.

    It keeps its state, and no call or message is lost, doubled or reordered. When
    something fails it goes on where it was, and the exit code is 1. A command-line
    component is stopped and started. A component that does not fit beside
    the running ones is refused, unless --force is given. With --dry-run it says
    what the move would change and cost; the exit code is 2 when it would be refused.

    Example: poise move localiser vision
    """
    running = Running(robot)
    if dry:
        seen = running.what_if(component, computer, force=force)
        show(seen, map(escape, what_if_lines(seen)), as_json=as_json)
        if seen.breaks and not force:
            raise typer.Exit(2)
        return
    with telling_progress(running, GOES_ON):
        _act(lambda: running.move(component, computer, force=force), as_json=as_json)


def replace_command(
    what: Annotated[
        str,
        typer.Argument(
            help="The component, or an architecture.",
            autocompletion=running("components"),
        ),
    ],
    by: Annotated[
        str,
        typer.Argument(
            help="package.module:Class, or with @VERSION of deployed code; or another "
            "architecture."
        ),
    ],
    adapt: Annotated[
        str, typer.Option(help="package.module:function that maps the old state.")
    ] = "",
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Drop the old state and begin without.")
    ] = False,
    watch: Annotated[
        str,
        typer.Option(
            help="The time in which the old one comes back if the new one crashes or "
            "misses more deadlines."
        ),
    ] = "0",
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Swap a running component's implementation, or a whole architecture.

    State is kept: --adapt maps it where it is another one, and --fresh drops it. An
    architecture is replaced by another that provides the same function: all its
    components take over at once, or none does.

    Examples
    --------
    poise replace localiser trot.navigator.scan_matcher:ScanMatcher

    poise replace localiser nav.localiser:Localiser@3fa2b1c04d11 --watch 30s
    """
    seconds = parse_option("--watch", watch, SECONDS)
    running = Running(robot)
    with telling_progress(running, GOES_ON):
        _act(
            lambda: running.replace(what, by, adapt=adapt, fresh=fresh, watch=seconds),
            as_json=as_json,
        )


def balance_command(
    cost: Annotated[
        float,
        typer.Option(help="What F grows by for a move, and for each MB of its state."),
    ] = 0.01,
    dry: Annotated[
        bool, typer.Option("--dry-run", help="Say what is best; move nothing.")
    ] = False,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Find a better placement for what a running robot needs now, and go there.

    Components move, one after the other, so that no computer is overfull midway. When
    one cannot, all go back to where they were, and the exit code is 1.

    Example: poise balance --dry-run
    """
    if not 0 <= cost <= _MOST_COST:
        raise UsageError(f"--cost {cost:g}: must be a number from 0 to {_MOST_COST:g}")
    running = Running(robot)
    with telling_progress(running, "nothing changes" if dry else GOES_ON):
        _act(lambda: running.balance(cost=cost, dry_run=dry), as_json=as_json)


def stop_command(
    robot: Robot = None,
    file: Annotated[
        Path | None,
        typer.Option(help="Robot file, of a robot that this computer does not know."),
    ] = None,
) -> None:
    """Stop a running robot, and wait until it has stopped.

    A move under way is rolled back. The exit code is 1 when something still runs. What
    a killed manager left is ended by its agents. With --file the robot's agents are
    asked where its manager is. Ctrl-C ends the waiting, and the robot goes on to stop.

    Example: poise stop
    """
    _check_one(file, robot)
    with busy("stopping"):
        if file is None:
            running = Running(robot)
            with telling_progress(running, "the robot is stopping"):
                running.stop()
        else:
            poise.stop_without_manager(poise.model.load(file))
    console_to().print("stopped")


def _act(act: Callable[[], Outcome], *, as_json: bool) -> None:
    """Print the outcome; exit with 1 if it was rolled back."""
    try:
        with busy("waiting for the manager"):
            outcome, is_done = act(), True
    except RolledBack as error:
        outcome, is_done = error.outcome, False
    show(outcome, outcome_lines(outcome), as_json=as_json)
    if not is_done:
        raise typer.Exit(1)


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
    One that fails at once is an error.

    Example: poise task start fetch
    """
    _show_begun(Running(robot).tasks.start(task, priority), as_json=as_json)


def pause_command(task: Name, robot: Robot = None, as_json: AsJson = False) -> None:
    """Pause a task: its components keep their state, and use no CPU.

    Example: poise task pause fetch
    """
    _show(Running(robot).tasks.pause(task), as_json=as_json)


def resume_command(task: Name, robot: Robot = None, as_json: AsJson = False) -> None:
    """Let a paused task go on.

    Example: poise task resume fetch
    """
    _show_begun(Running(robot).tasks.resume(task), as_json=as_json)


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
    show(tasks, [task_table(tasks)], as_json=as_json)


def show_command(task: Name, robot: Robot = None, as_json: AsJson = False) -> None:
    """Show a task of a running robot: its actions, and what they use.

    Example: poise task show fetch
    """
    _show(Running(robot).tasks.show(task), as_json=as_json)


def _show_begun(report: TaskReport, *, as_json: bool) -> None:
    _show(report, as_json=as_json)
    if report.state == "failed":
        raise typer.Exit(1)


def _show(report: TaskReport, *, as_json: bool) -> None:
    show(report, (*task_lines([report]), *action_lines(report)), as_json=as_json)


task_command = list_command
