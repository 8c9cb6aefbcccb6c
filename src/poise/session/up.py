"""Keeps a robot up: its manager works on a thread of its own until it is stopped."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from poise.errors import PoiseError, RunError, UsageError
from poise.manage.adaptation.replan import propose
from poise.manage.control import (
    Answered,
    AskAlternative,
    AskBalance,
    Asked,
    AskMove,
    AskReplace,
    AskStatus,
    AskStop,
    Balanced,
    ControlServer,
    Moved,
    Replaced,
    RobotStatus,
    Stopping,
)
from poise.manage.journal import Journal
from poise.manage.migration.move import move, replace
from poise.manage.migration.replacement import replace_architecture
from poise.manage.migration.transition_run import transit
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.prometheus import MetricsServer
from poise.manage.observe.recording import Recording, save
from poise.model.robot import Robot
from poise.session.placement import Placement, runnable
from poise.session.profiles import read_profile
from poise.session.robot_file import task_of
from poise.session.running import Running
from poise.session.say import Say, log
from poise.session.start import Sampling, Started, started
from poise.wire.records.recorded import Recorded
from poise.wire.records.samples import AgentSample

if TYPE_CHECKING:
    from poise.manage.observe.opentelemetry import Telemetry

_LOOK_EVERY = 0.2
_END_LIMIT = 60.0
"""What the manager has begun, such as a move, ends within this time [s]."""


class Up(Running):
    """A robot that this process keeps up."""

    def __init__(self, name: str, manager: Manager) -> None:
        super().__init__(name)
        self._manager = manager

    def wait(self, seconds: float | None = None) -> bool:
        """Wait up to `seconds` [s] until the robot is stopped; return whether it is.

        Raises
        ------
        RunError
            It broke: a computer was lost.
        """
        return self._manager.wait(seconds)


@contextlib.contextmanager
def up(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str | None = None,
    *,
    placement: Placement | None = None,
    journal: Path | None = None,
    metrics: int | None = None,
    otel: str | None = None,
    record: Path | None = None,
    say: Say = log.info,
) -> Iterator[Up]:
    """Start a robot, keep it up inside the ``with`` block, and stop it afterwards.

    Parameters
    ----------
    task
        Its name; None: the robot's first.
    placement
        What `poise.place` decided; None: it is decided here.
    journal
        A file for every decision (SQLite); None: it is not kept.
    metrics
        TCP port for Prometheus, on this computer; None: none.
    otel
        URL of an OpenTelemetry collector (OTLP/HTTP); None: none.
    record
        A file for what agents say of what is used; None: it is not kept.
    say
        Takes a sentence at every step. It may be called on another thread.

    Raises
    ------
    RobotError, RunError
        It cannot start, or it broke meanwhile; everything is down again.
    UsageError
        A robot of this name runs already.
    """
    chosen = task_of(robot, task)
    placed = runnable(robot, chosen, placement)
    send = _telemetry() if otel is not None else None
    with contextlib.ExitStack() as stack:
        control_server = ControlServer(robot.name)
        stack.callback(control_server.close)
        book = Journal(journal or ":memory:")
        stack.callback(book.close)
        emulated = all(computer.address is None for computer in robot.computers)
        estimates = Estimates(robot, read_profile(robot), emulated=emulated)
        recording = Recording()
        if record is not None:
            stack.callback(
                lambda: save(
                    Recorded(robot=robot.name, samples=recording.take()), record
                )
            )
        samples = Samples(estimates, recording if record else None, say)
        it = stack.enter_context(
            started(robot, placed.where, book, say, Sampling(samples.take))
        )
        agents = it.run.agents
        if metrics is not None:
            server = MetricsServer(estimates, agents.statuses, ("127.0.0.1", metrics))
            stack.callback(server.close)
        if send is not None and otel is not None:
            to = send(robot.name, estimates, agents.statuses, otel)
            stack.callback(to.close)
        manager = Manager(it, chosen, estimates, samples, control_server)
        with manager:
            yield Up(robot.name, manager)


def _telemetry() -> type[Telemetry]:
    """Return the class that sends metrics; UsageError when its extra is missing."""
    try:
        from poise.manage.observe.opentelemetry import Telemetry
    except ImportError as error:
        raise UsageError(
            f"--otel needs OpenTelemetry: pip install 'poise[otel]' ({error})"
        ) from error
    return Telemetry


class Samples:
    """Takes what agents say of what is used."""

    def __init__(
        self, estimates: Estimates, recording: Recording | None, say: Say
    ) -> None:
        self._estimates = estimates
        self._recording = recording
        self._say = say
        self._has_ended = False

    def end(self) -> None:
        """Take no more: without a simulated world sensors are silent."""
        if not self._has_ended:
            self._has_ended = True
            self._say("the simulated world has ended: estimates stay as they are")

    def take(self, sample: AgentSample) -> None:
        """Estimate, keep, and say when a demand has shifted."""
        if self._has_ended:
            return
        if self._recording is not None:
            self._recording.add(sample)
        for name, drift in self._estimates.take(sample):
            self._say(
                f"'{name}' needs {drift.after:.1%} of a core now, "
                f"{drift.before:.1%} before"
            )


class Manager:
    """Watches a running robot and answers what is asked of it, on its own thread.

    It works inside its ``with`` block, which raises what broke.
    """

    def __init__(
        self,
        started: Started,
        task: str,
        estimates: Estimates,
        samples: Samples,
        control: ControlServer,
    ) -> None:
        self._started = started
        self._run = started.run
        self._task = task
        self._estimates = estimates
        self._samples = samples
        self._control = control
        self._is_stopping = False
        self._error: PoiseError | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._main, name="manager", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        _type: type[BaseException] | None,
        error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        self._is_stopping = True
        if not self._ended.wait(_END_LIMIT):
            raise RunError(f"the manager was still busy after {_END_LIMIT:g} s")
        if error is None:
            self.wait(0.0)

    def wait(self, seconds: float | None) -> bool:
        """Wait up to `seconds` [s] for its end; raise what broke."""
        has_ended = self._ended.wait(seconds)
        if self._error is not None:
            raise self._error
        return has_ended

    def _main(self) -> None:
        try:
            while not self._is_stopping:
                self._control.serve(self.answer, _LOOK_EVERY)
                self._run.raise_on_lost()
                world = self._started.world
                if world is not None and world.has_ended():
                    self._samples.end()
        except PoiseError as error:
            self._error = error
        finally:
            self._ended.set()

    def answer(self, asked: Asked) -> Answered:
        """Do what is asked."""
        run = self._run
        match asked.what:
            case AskMove(component, computer):
                return Answered(Moved(move(run, component, computer)))
            case AskReplace(component, implementation, adapt):
                return Answered(Moved(replace(run, component, implementation, adapt)))
            case AskBalance(cost, dry):
                return Answered(self._balance(cost, dry=dry))
            case AskAlternative(architecture, by, adapt):
                return Answered(
                    Replaced(replace_architecture(run, architecture, by, adapt))
                )
            case AskStop():
                self._is_stopping = True
                return Answered(Stopping())
            case AskStatus():
                return Answered(
                    RobotStatus(
                        robot=run.robot.name,
                        task=self._task,
                        placement=run.placement(),
                        computers=run.agents.statuses(),
                        lost=tuple(sorted(run.agents.lost())),
                        demand_estimates=tuple(self._estimates.demand_estimates()),
                    )
                )

    def _balance(self, move: float, *, dry: bool) -> Balanced:
        run, demand_estimates = self._run, self._estimates.demand_estimates()
        proposal = propose(
            run.robot, self._task, run.placement(), demand_estimates, move
        )
        if dry or not proposal.steps:
            return Balanced(proposal)
        return Balanced(proposal, transit(run, proposal.steps))
