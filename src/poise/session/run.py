"""Runs a task from nothing to a report, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections import Counter
from collections.abc import Callable
from os import PathLike
from typing import Self

from msgspec import structs

from poise import threads
from poise.clock import wall_time
from poise.errors import PoiseError, RunError, UsageError
from poise.estimate.success_rates import as_learned
from poise.manage.control_socket.control_server import ControlServer
from poise.manage.deploy.deactivation import drain, stop
from poise.manage.journal import JournalEntry
from poise.manage.manager import Manager
from poise.manage.observe.chains import chain_reports
from poise.model.robot import Robot
from poise.session import Check, Say, log, nothing
from poise.session.arguments import check_duration, check_path
from poise.session.deploy.deploy import as_deployed
from poise.session.last_seen import LastSeen
from poise.session.launch.computers import outlive_manager
from poise.session.launch.managed import journal_of, managed, planned
from poise.session.launch.start import Started
from poise.session.placing.first_phase import first_phase
from poise.session.placing.placement import Placement
from poise.session.record_run import keeping
from poise.session.robot_file import task_of
from poise.session.run_records import History
from poise.session.run_report import MeasuredRun, RunReport, located_faults, reported
from poise.session.running_robots.running import Running
from poise.units import counted
from poise.wire.heartbeats import UNCUT_SURELY_ENDED

Meanwhile = Callable[[Running, float], object]
"""Called a few times a second, on a thread of its own, with the robot that runs and its
time so far [s]; may move components, and may raise to end the run."""
_MEANWHILE_EVERY = 0.25
_MEANWHILE_LIMIT = 60.0


def run(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str | None = None,
    *,
    seconds: float,
    placement: Placement | None = None,
    journal: str | PathLike[str] | None = None,
    record: str | PathLike[str] | None = None,
    adapt: bool = False,
    say: Say = log.info,
    meanwhile: Meanwhile = nothing,
    check: Check = nothing,
) -> RunReport:
    """Run a task until it is over, or some time or the simulated world is, and report.

    At the end all components are deactivated from sources to targets, so that the
    report has the final counts. Ctrl-C (`KeyboardInterrupt`) ends it early, and the
    report says so; the same while it starts is raised. An agent that is killed and
    started again ends nothing.

    Parameters
    ----------
    task
        Its name; None: the robot's first.
    seconds
        How long at most [s].
    placement
        What `poise.place` decided; None: it is decided here.
    journal
        A file for every decision, a line of JSON each; None: it is in the user's state
        folder. `poise journal` finds both.
    record
        A file for what is used and what is published between architectures; None: it
        is not kept. One that is there already is kept beside it, as ``NAME-before``.
    adapt
        Whether Poise changes the placement by itself, as `up` does.
    say
        Takes a sentence at every step.
    meanwhile
        Called a few times a second while the task runs, on a thread of its own, with
        the robot and the time so far [s]: it may ask for the status, move components,
        start tasks. An exception ends the run. It is not called where another robot of
        this name runs here.
    check
        Called several times a second; may raise `KeyboardInterrupt`.

    Raises
    ------
    UsageError
        The robot runs already, or an argument is wrong.
    RobotError, RunError
        It cannot start, a component failed, a computer was lost, or `meanwhile` did not
        return in the minute after the run; everything is down again.
    """
    chosen, decided = task_of(robot, task), list[str]()
    check_duration("a run", seconds)
    if not callable(meanwhile):
        raise UsageError(f"meanwhile: {meanwhile!r} is no function")
    check_path("journal", journal or "")
    check_path("record", record or "")
    robot = as_deployed(as_learned(robot, [chosen]))
    first = first_phase(robot, [chosen], placement, decided.append)
    placed, warnings = first.placed, Warnings(say)
    decided.insert(0, f"task '{chosen}', {placed.method} placement")
    with contextlib.ExitStack() as stack:
        book = stack.enter_context(
            journal_of(robot, first, journal, warnings.hear, decided)
        )
        server = _server(robot, stack, say)
        beside = _Beside(meanwhile if server is not None else nothing, robot.name)
        stack.enter_context(beside)  # it ends once its last request is answered
        kept = stack.enter_context(keeping(robot, placed.where, record, say))
        answering = stack.enter_context(contextlib.ExitStack())
        what = planned(kept.robot, first)
        up, manager = stack.enter_context(
            managed(what, book, say, check, adapts=adapt, recorder=kept.recorder)
        )
        answering.callback(manager.end)
        shows = ""
        if server is not None:
            server.start(manager.submit)
            shows = "; `poise top` and `poise dashboard` show it"
        say(f"running task '{chosen}' for up to {seconds:g} s{shows}")
        seen = _measure(up, seconds, manager, check, beside)
        drain(up.live, seen.last_seen.unprocessed)
        warnings.end()
        entries = tuple(book.entries())
        if book.forgotten:
            lacks = counted(book.forgotten, "earlier line")
            say(f"the report lacks {lacks} of the journal; `poise journal` has more")
        report = reported(up, placed, manager.tasks.reports, seen, entries)
        stop(up.live)
        report = structs.replace(report, faults=located_faults(up.live))
    return structs.replace(report, unrecorded=kept.lacks)


class Warnings:
    """Says what is wrong when it comes first, and in the end how often it came."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self._first: dict[str, str] = {}
        self._times: Counter[str] = Counter()

    def hear(self, entry: JournalEntry) -> None:
        """Take an entry of the journal."""
        if entry.kind not in {"wrong", "right"} or entry.what.startswith("no more: "):
            return
        # the same thing with other figures, or another cause, is the same
        key = _FIGURES.sub("", entry.what.partition(": ")[0])
        self._times[key] += 1
        if key not in self._first:
            self._first[key] = entry.what
            self._say(str(entry))

    def end(self) -> None:
        """Say what came more than once."""
        for key, times in self._times.most_common():
            if times > 1:
                self._say(f"{times} times: {self._first[key]}")


_FIGURES = re.compile(r"(?<![\w-])[\d.]+")
"""Figures, but not those of names such as `arm-2`."""


def _server(
    robot: Robot, stack: contextlib.ExitStack, say: Say
) -> ControlServer | None:
    """Open the control socket; without one, a run goes on unwatched."""
    try:
        return stack.enter_context(ControlServer(robot.name))
    except PoiseError as error:
        if isinstance(error, UsageError) and outlive_manager(robot):
            raise
        say(f"this run cannot be watched: {error}")
        return None


class _Beside:
    """Calls a user's function while a task runs, on a thread of its own."""

    def __init__(self, call: Meanwhile, robot: str) -> None:
        self._call = call
        self._running = Running(robot)
        self._error: Exception | None = None
        self._is_over = threading.Event()
        self._thread = threads.daemon(self._main, "meanwhile")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        self._is_over.set()
        if not self._thread.ident:
            return
        self._thread.join(_MEANWHILE_LIMIT)
        if self._thread.is_alive():
            raise RunError(
                f"`meanwhile` did not return within {_MEANWHILE_LIMIT:g} s after the "
                "run: it is called again and again, and should not wait for long"
            )
        # once the run is over, what it asks of the robot is refused
        if error is None and not isinstance(self._error, PoiseError):
            self.check()

    def begin(self) -> None:
        """Begin: the task runs now."""
        self._thread.start()

    def end(self) -> None:
        """Begin no further call; raise what was raised."""
        self._is_over.set()
        self.check()

    def check(self) -> None:
        """Raise what was raised."""
        if self._error is not None:
            raise self._error

    def _main(self) -> None:
        began = time.monotonic()
        try:
            while not self._is_over.wait(_MEANWHILE_EVERY):
                self._call(self._running, time.monotonic() - began)
        except Exception as error:  # noqa: BLE001, `check` raises it
            self._error = error


def _measure(
    up: Started, seconds: float, manager: Manager, check: Check, beside: _Beside
) -> MeasuredRun:
    """Let it run until its end; a computer that is lost ends it by an error."""
    live, looks = up.live, up.live.check
    up.computers.begin()
    history, last_seen = History(live.robot, up.computers.faster), LastSeen()
    live.agents.on_status = last_seen.record_status
    begin, began, at = live.agents.statuses(), time.monotonic(), wall_time()
    last_seen.record(begin)
    interrupted = False

    def look_around() -> None:
        check()
        beside.check()
        looks()
        up.computers.raise_if_ended()
        if lost := manager.lost.computers():
            lost_one = min(lost)
            what = f"computer '{lost_one}' is out of reach"
            raise RunError(live.unreached().get(lost_one, what))

    def look(_: float) -> None:
        now, statuses = time.monotonic(), live.agents.statuses()
        history.record(statuses, wall_time(), now)
        manager.work(0.0)

    live.check = look_around
    beside.begin()
    try:
        up.watch(seconds, look, manager.tasks.is_over)
        if manager.lost.away():  # an agent is started again: it has counts, too
            up.watch(UNCUT_SURELY_ENDED, look, lambda: not manager.lost.away())
    except KeyboardInterrupt:
        interrupted = True
    except RunError:
        if not manager.is_stopping:
            raise
    beside.end()
    stopped = "`poise stop` ended it" if manager.is_stopping else ""
    live.check = check
    end = live.agents.statuses()
    return MeasuredRun(
        begin=begin,
        end=end,
        chains=chain_reports(live.robot, last_seen.merged(end)),
        began=at,
        history=tuple(history.moments),
        last_seen=last_seen,
        seconds=time.monotonic() - began,
        invalid="; ".join(filter(None, [stopped, up.computers.end()])),
        interrupted=interrupted or bool(stopped),
    )
