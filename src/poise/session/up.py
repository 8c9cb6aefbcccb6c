"""Keeps a robot up: its manager works on a thread of its own until it is stopped."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Self
from urllib.parse import urlsplit

from msgspec.structs import replace

from poise import threads
from poise.decoding import from_msgpack
from poise.emulate import EmulatedComputer
from poise.errors import RunError, TakenOver, UsageError
from poise.estimate.success_rates import as_learned
from poise.manage.control_socket.commands import StopCommand
from poise.manage.control_socket.control_server import ControlServer
from poise.manage.deploy.takeover import start_or_take_over
from poise.manage.journal import Journal, check_journal
from poise.manage.manager import TICK, Manager
from poise.manage.observe.sample_recording import RecordingFile
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.model.robot import Robot
from poise.runtime.container.component_import import folder_of_version
from poise.session import Check, Say, log, nothing
from poise.session.arguments import check_path, check_robot, check_type
from poise.session.deploy.deploy import as_deployed
from poise.session.folders import make_journal
from poise.session.launch.computers import Computers, outlive_manager
from poise.session.launch.managed import (
    StandbySetup,
    ToManage,
    election_of,
    journal_of,
    managed,
    planned,
    without_standbys,
)
from poise.session.launch.start import Started
from poise.session.placing.first_phase import first_phase
from poise.session.placing.placement import Placement
from poise.session.record_run import new_recording
from poise.session.robot_file import task_of
from poise.session.running_robots.running import Running
from poise.wire.address import KEYS
from poise.wire.records.request_records import Claim
from poise.wire.robots_here import AgentAddresses

if TYPE_CHECKING:
    from poise.manage.observe.opentelemetry import Telemetry
    from poise.manage.observe.prometheus import MetricsServer


_PORTS = 1 << 16
_END_LIMIT = 60.0
"""What the manager has begun, such as a move, ends within this time [s]."""


class Up(Running):
    """A robot that this process keeps up: its manager works on a thread of its own."""

    def __init__(
        self, started: Started, manager: Manager, recorder: RecordingFile | None
    ) -> None:
        super().__init__(started.live.robot.name)
        self.started = started
        self._recorder = recorder
        self._manager = manager
        self._error: Exception | None = None
        self._ended = threading.Event()
        self._thread = threads.daemon(self._main, "manager")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        self._manager.submit(StopCommand())
        if not self._ended.wait(_END_LIMIT):
            raise RunError(f"the manager was still busy after {_END_LIMIT:g} s")
        if error is None:
            self.wait(0.0)

    @property
    def emulated(self) -> Mapping[str, EmulatedComputer]:
        """The emulated computers, by name, to load and to break; none of a real robot.

        ``running.emulated["left"].popen(["stress", "--cpu", "1"])`` starts a program
        that competes with the robot's components.
        """
        return self.started.computers.emulated

    @property
    def unrecorded(self) -> str:
        """What of the recording could not be written, and why; empty: all was."""
        return self._recorder.trouble if self._recorder is not None else ""

    def wait(self, seconds: float | None = None) -> bool:
        """Wait up to `seconds` [s] until the robot is stopped; return whether it is.

        Raises RunError: something still runs, because its computer is out of reach.
        """
        has_ended = self._ended.wait(seconds)
        if self._error is not None:
            raise self._error
        return has_ended

    def _main(self) -> None:
        try:
            self._keep_up()
        except Exception as error:  # noqa: BLE001, `wait` raises it
            self._error = error
        finally:
            self._ended.set()

    def _keep_up(self) -> None:
        live = self.started.live
        try:
            while not self._manager.is_stopping:
                if not live.parts.run("carry on", self._work):
                    live.clock.sleep(TICK)
        finally:  # it was asked for, or another manager has the robot
            self._manager.stop()

    def _work(self) -> bool:
        world = self.started.world
        self._manager.work(TICK)
        if world is not None and world.has_ended():
            self._manager.end_estimates()
        return True


@contextlib.contextmanager
def up(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str | Sequence[str] | None = None,
    *,
    placement: Placement | None = None,
    journal: str | PathLike[str] | None = None,
    metrics: int | None = None,
    otel: str | None = None,
    record: str | PathLike[str] | None = None,
    adapt: bool = True,
    take_over: bool = False,
    say: Say = log.info,
    check: Check = nothing,
) -> Iterator[Up]:
    """Start a robot, keep it up inside the ``with`` block, and stop it afterwards.

    When it runs without a manager, because that was killed, this one takes it over:
    what runs as the robot file says goes on, and the rest is restarted.

    Parameters
    ----------
    task
        Its name, or those of several; None: the robot's first.
    placement
        What `poise.place` decided; None: it is decided here, and what runs already
        stays where it is.
    journal
        A file for every decision, a line of JSON each; None: it is in the user's state
        folder. `poise journal` finds both.
    metrics
        TCP port for Prometheus, on this computer; None: none.
    otel
        URL of an OpenTelemetry collector (OTLP/HTTP); None: none.
    record
        A file for what agents say of what is used, and for what policies see; None: it
        is not kept. One that is there already is kept beside it, as ``NAME-before``.
    adapt
        Whether Poise changes the placement by itself when components miss their
        deadlines, or their computer is overloaded.
    take_over
        Whether to take it over though another manager is alive, which then ends.
    say
        Takes a sentence at every step, and each entry of the journal. It is called on
        the manager's thread, too, and must not block.
    check
        Called several times a second until it is up; may raise `KeyboardInterrupt`.

    Raises
    ------
    RobotError, RunError
        It cannot start, or it broke meanwhile; everything is down again.
    TakenOver
        Another manager has taken it over; it goes on.
    UsageError
        A robot of this name runs already, or an argument is wrong.
    """
    check_path("journal", journal or "")
    check_path("record", record or "")
    check_type("metrics", metrics, int | None, "a port")
    check_type("otel", otel, str | None, "a URL, as http://localhost:4318")
    check_robot(robot)
    if take_over and not outlive_manager(robot):
        raise UsageError(
            f"the emulated computers of robot '{robot.name}' end with its manager: "
            "only ones that `poise emulate` keeps can be taken over"
        )
    names = _tasks_of(robot, task)
    if metrics is not None and not 0 < metrics < _PORTS:
        raise UsageError(f"metrics on port {metrics}: it is from 1 to {_PORTS - 1}")
    robot = as_deployed(as_learned(robot, names))
    decided: list[str] = []
    first = first_phase(robot, names, placement, decided.append)
    send = _telemetry(otel) if otel is not None else None
    if sentence := without_standbys(robot):
        say(sentence)
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(ControlServer(robot.name, takes_over=take_over))
        exporter = None
        if metrics is not None and not take_over:  # before anything is started
            exporter = stack.enter_context(_exporter(metrics))
        check_journal(Path(journal) if journal else None)
        recorder = new_recording(Path(record), robot.name) if record else None
        book = stack.enter_context(
            journal_of(robot, first, journal, lambda entry: say(str(entry)), decided)
        )
        if recorder is not None:
            stack.callback(lambda: say(str(recorder)))
            stack.callback(recorder.close)
        begin = partial(
            start_or_take_over, is_rule=placement is not None, by_force=take_over
        )
        it, manager = stack.enter_context(
            managed(
                planned(robot, first, election_of(robot, adapts=adapt)),
                book,
                say,
                check,
                adapts=adapt,
                recorder=recorder,
                begin=begin,
            )
        )
        if send is not None and otel is not None:
            sender = send(robot.name, manager.status, otel, say)
            stack.callback(sender.close)
        running = stack.enter_context(Up(it, manager, recorder))
        server.start(manager.submit)
        if metrics is not None and exporter is None:
            try:
                exporter = stack.enter_context(_exporter(metrics, _END_LIMIT))
            except RunError as error:  # the robot has no other manager any more
                say(str(error))
        if exporter is not None:
            exporter.show(manager.status)
        yield running


def _tasks_of(robot: Robot, task: str | Sequence[str] | None) -> Sequence[str]:
    """Return the tasks to start; UsageError when a list names none, or one twice."""
    check_type("task", task, str | Sequence | None, "the name of a task, or several")
    if task is None or isinstance(task, str):
        return [task_of(robot, task)]
    if not task:
        raise UsageError("name a task to start, or leave it out for the robot's first")
    if twice := next((each for each in task if task.count(each) > 1), None):
        raise UsageError(f"task '{twice}' is named twice; name each task once")
    return [task_of(robot, each) for each in task]


def _exporter(port: int, patience: float = 0.0) -> MetricsServer:
    from poise.manage.observe.prometheus import MetricsServer

    return MetricsServer("127.0.0.1", port, patience)


def _is_url(url: str) -> bool:
    try:
        parts = urlsplit(url)
        is_http = parts.scheme in {"http", "https"}
        return is_http and bool(parts.hostname) and parts.port != 0
    except ValueError:  # the brackets of an IPv6 address, or the port
        return False


def _telemetry(url: str) -> type[Telemetry]:
    """Return the class that sends metrics; UsageError: none, or the URL is none."""
    if not _is_url(url):
        raise UsageError(f"otel '{url}' is no URL, as in http://localhost:4318")
    try:
        from poise.manage.observe.opentelemetry import Telemetry
    except ImportError as error:
        raise UsageError(
            f"--otel needs OpenTelemetry: pip install 'poise[otel]' ({error})"
        ) from error
    return Telemetry


def stand_by(path: Path, words: Iterable[str], say: Say) -> None:
    """Lead as the claim in a file says, at each word ``lead`` of an agent."""
    for word in words:
        if word.strip() == "end":
            return
        if word.strip() == "lead":
            claim = from_msgpack(path.read_bytes(), Claim)
            try:
                _lead(claim, say)
            except RunError as error:
                say(str(error))
                if isinstance(error, TakenOver):
                    return  # with all that it knew
            else:
                return


def _lead(claim: Claim, say: Say) -> None:
    """Become the leader of a robot that runs, and lead it to its end."""
    assert claim.election is not None  # noqa: S101, or there would be no standby
    setup = from_msgpack(claim.election.setup, StandbySetup)
    robot = replace(setup.robot, simulator=None)  # it ended with who started it
    if robot.deployed:  # what its policies call
        robot = replace(robot, folder=folder_of_version(robot.deployed))
    with contextlib.ExitStack() as stack:
        journal = Journal(make_journal(robot.name), lambda entry: say(str(entry)))
        stack.callback(journal.close)
        agents = AgentAddresses(robot.name, claim.agents, os.environ.get(KEYS, ""))
        what = ToManage(
            robot=robot,
            where={},
            tasks=Tasks(robot),
            election=claim.election,
            computers=Computers(agents),
        )
        it, manager = stack.enter_context(
            managed(
                what,
                journal,
                say,
                nothing,
                adapts=setup.adapts,
                recorder=None,
                begin=lambda run: start_or_take_over(run, follows=True),
            )
        )
        server = stack.enter_context(ControlServer(robot.name, takes_over=True))
        running = stack.enter_context(Up(it, manager, None))
        server.start(manager.submit)
        running.wait()
