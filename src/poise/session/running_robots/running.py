"""A running robot, to observe and to command: from this process or another."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterator
from numbers import Real
from typing import Literal

from poise.errors import RunError, Timeout, UsageError, did_you_mean, listed
from poise.manage.control_socket.agents_without_manager import NoManager
from poise.manage.control_socket.commands import (
    JournalCommand,
    JournalEntries,
    LogCommand,
    LogReading,
    MoveCommand,
    RebalanceCommand,
    Rebalanced,
    ReplaceCommand,
    RobotStatus,
    StatusCommand,
    StopCommand,
    StopReport,
    TapCommand,
    TaskCommand,
    TaskDone,
)
from poise.manage.control_socket.control_client import ask
from poise.manage.journal import JournalEntry
from poise.manage.migration.migration_report import MigrationReport, WhatIf
from poise.manage.observe.chains import ChainReport
from poise.manage.tasks.task_reports import OVER, TaskReport
from poise.session.arguments import check_amount, check_type
from poise.session.render.status_tables import Status
from poise.session.render.tables import Outcome, outcome_sentence
from poise.session.running_robots.running_component import RunningComponent
from poise.wire.records.request_records import SHOWN_ITEMS, TapReading

_TASK_POLLED_EVERY = 0.05


class RunningTasks:
    """The tasks of a running robot.

    Every method raises `UsageError` when the robot's manager refuses, `RunError` when
    it gives no answer, and `NoManager` when the robot goes on without one.
    """

    def __init__(self, robot: str | None) -> None:
        self._robot = robot

    def start(self, task: str, priority: int | None = None) -> TaskReport:
        """Start a task; it runs beside others, or waits for them.

        `priority`: None: that of the robot file.
        """
        return self._do("start", task, priority)

    def pause(self, task: str) -> TaskReport:
        """Pause a task until it is resumed; its components keep their state."""
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

        Raises Timeout: it was not within `seconds` [s].
        """
        check_type("seconds", seconds, Real, "a number")
        until = time.monotonic() + seconds
        while (report := self.show(task)).state not in OVER:
            if not time.monotonic() <= until:  # also when that is no number
                raise Timeout(
                    f"task '{task}' is {report.state} after {seconds:g} s"
                    + (f": {report.why}" if report.why else "")
                )
            time.sleep(_TASK_POLLED_EVERY)
        return report

    def _do(
        self,
        verb: Literal["start", "pause", "resume", "cancel"],
        task: str,
        priority: int | None = None,
    ) -> TaskReport:
        return ask(self._robot, TaskCommand(verb, task, priority), TaskDone).report


_LOOK_EVERY = 0.25
"""What goes out over a connector is fetched after this time [s]."""
__all__ = [
    "ChainReport",
    "JournalEntry",
    "NoManager",
    "RolledBack",
    "Running",
    "Status",
    "WhatIf",
    "connect",
]


class RolledBack(RunError):
    """A move, a replacement or a new balance failed, and all goes on as before.

    Parameters
    ----------
    outcome
        How it went.
    """

    def __init__(self, message: str, outcome: Outcome) -> None:
        super().__init__(message)
        self.outcome = outcome


class Running:
    """A robot that is up.

    Every method raises `UsageError` when the robot's manager refuses, `RunError` when
    it gives no answer, and `NoManager` when the robot goes on without one.

    Parameters
    ----------
    name
        The robot's name; None: the only one that runs here.
    """

    def __init__(self, name: str | None = None) -> None:
        self.name = name

    @property
    def tasks(self) -> RunningTasks:
        """Its tasks: ``running.tasks.start("fetch")``."""
        return RunningTasks(self.name)

    def component(self, name: str) -> RunningComponent:
        """Return a component of it: to call it, send it messages, hear its own.

        ``running.component("heater").call("heating", "heat", 0.4)``

        Raises
        ------
        UsageError
            There is no such component.
        """
        self._check_component(name)
        return RunningComponent(self.name, name)

    def _check_component(self, name: str) -> None:
        status = self.status()
        # some may not run now
        known = sorted({*status.placement, *status.memory_demands})
        if name not in known:
            raise UsageError(
                f"no component '{name}'{did_you_mean(name, known)}; there are "
                f"{listed(known)}"
            )

    def status(self) -> Status:
        """Return where components run, and how they and their computers are.

        Without a manager it is `by_agents`; only where they are not known, it raises.
        """
        try:
            status = ask(self.name, StatusCommand(), RobotStatus)
        except NoManager as error:
            if error.status is None:
                raise
            status = error.status
        return Status.of(status)

    def move(
        self, component: str, computer: str, *, force: bool = False
    ) -> MigrationReport:
        """Move a component to another computer, with its state.

        Parameters
        ----------
        force
            Whether to move it even where it does not fit beside the running components,
            and in spite of its layer.

        Raises
        ------
        RolledBack
            It failed; the component goes on where it was.
        """
        return self._migrate(MoveCommand(component, computer, force))

    def what_if(self, component: str, computer: str, *, force: bool = False) -> WhatIf:
        """Return what a move would change; nothing happens.

        Raises UsageError when it would be refused, but for limits that it would break:
        they are in the answer.
        """
        command = MoveCommand(component, computer, force=force, dry=True)
        return ask(self.name, command, WhatIf)

    def journal(self, after: int = 0) -> tuple[JournalEntry, ...]:
        """Return the last entries of its journal, oldest first: 500 at most.

        Parameters
        ----------
        after
            Only entries with a higher number.
        """
        return ask(self.name, JournalCommand(after), JournalEntries).entries

    def replace(
        self,
        what: str,
        by: str,
        *,
        adapt: str = "",
        fresh: bool = False,
        watch: float = 0.0,
    ) -> MigrationReport:
        """Swap a component's implementation, or an architecture for another.

        Parameters
        ----------
        what
            A component, or an architecture.
        by
            ``package.module:Class``, ``package.module:Class@VERSION`` of deployed code,
            or another architecture of the same function.
        adapt
            ``package.module:function`` that maps the old state to the new one.
        fresh
            Whether the old state is dropped.
        watch
            For how long the component before comes back by itself when the new one
            crashes, or misses more deadlines [s].

        Raises
        ------
        RolledBack
            It failed; all goes on as before.
        """
        check_amount("watch", watch)
        return self._migrate(ReplaceCommand(what, by, adapt, fresh, watch))

    def balance(self, *, cost: float = 0.01, dry_run: bool = False) -> Rebalanced:
        """Place the robot again, from what its components need now.

        Parameters
        ----------
        cost
            What F grows by for a move, and for each MB of its state.
        dry_run
            Whether to return the proposal only.

        Raises
        ------
        RolledBack
            A move failed; everything is where it was.
        """
        check_amount("cost", cost)
        answer = ask(self.name, RebalanceCommand(cost, dry_run), Rebalanced)
        if answer.report is not None and not answer.report.committed:
            raise RolledBack(f"rolled back: {answer.report.reason}", answer)
        return answer

    def echo(self, connector: str, *, rate: float = 10.0) -> Iterator[TapReading]:
        """Yield what goes out over a connector, some times a second, without end.

        Nothing is slowed down for it, and nobody else gets less.

        Parameters
        ----------
        connector
            Its name, or ``component.port`` of one of its ends.
        rate
            This number of messages or calls a second comes with its content, the
            others with their time alone.
        """
        check_amount("rate", rate)
        viewer = secrets.token_hex(8)
        latest = (0, 0)
        while True:
            reading = self.look_at(connector, viewer, rate=rate, latest=latest)
            latest = reading.latest
            yield reading
            time.sleep(_LOOK_EVERY)

    def look_at(
        self,
        connector: str,
        viewer: str,
        *,
        rate: float,
        items: int = SHOWN_ITEMS,
        is_whole: bool = False,
        latest: tuple[int, int] | None = None,
    ) -> TapReading:
        """Return what went out over a connector since this viewer looked last.

        Parameters
        ----------
        viewer
            Tells it from others that look at the same. Three seconds after its last
            look, nothing is noted for it any more.
        rate
            This number of messages or calls a second comes with its content.
        items
            Of longer lists, arrays and mappings the rest is left out.
        is_whole
            Whether contents are `poise.wire.codec.Packed`, with nothing left out.
        latest
            Where a port is ``published(latest=True)``: its last message comes, too,
            when it is later than that with this number; None: it does not.
        """
        command = TapCommand(connector, viewer, rate, items, is_whole, latest)
        return ask(self.name, command, TapReading)

    def log(
        self, component: str = "", *, last: int = 100, follow: bool = False
    ) -> Iterator[LogReading]:
        """Yield what components wrote to standard output and error, or logged.

        Parameters
        ----------
        component
            Only its lines; empty: all.
        last
            At most so many lines at first.
        follow
            Whether to yield what comes later, some times a second, without end.

        Raises
        ------
        UsageError
            There is no such component.
        """
        if component:
            self._check_component(component)
        reading = ask(self.name, LogCommand(component, most=last), LogReading)
        yield reading
        while follow:
            time.sleep(_LOOK_EVERY)
            reading = ask(self.name, LogCommand(component, reading.after), LogReading)
            yield reading

    def stop(self) -> None:
        """Stop the robot, and wait until it has stopped.

        One whose manager is gone is stopped by its agents.

        Raises
        ------
        RunError
            Something still runs on a computer that is out of reach.
        NoManager
            A manager is there, and does not answer.
        """
        try:
            remaining = ask(self.name, StopCommand(), StopReport).remaining
        except NoManager as error:
            if error.left is None:
                raise
            # what leads agents is slow to import, and hardly ever needed
            from poise.session.running_robots.without_manager import stop_agents  # noqa: PLC0415

            stop_agents(error.left)
            return
        if remaining:
            raise RunError("\n".join(remaining))

    def _migrate(self, command: MoveCommand | ReplaceCommand) -> MigrationReport:
        report = ask(self.name, command, MigrationReport)
        if not report.committed:
            raise RolledBack(outcome_sentence(report), report)
        return report


def connect(name: str | None = None) -> Running:
    """Return a robot that another process keeps up, from any of its computers.

    Parameters
    ----------
    name
        The robot's name; None: the only one that runs here.

    Raises
    ------
    UsageError
        No such robot runs, or several do and none is named.
    """
    running = Running(name)
    running.name = running.status().robot
    return running
