"""`poise up`: start a robot and keep it running."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from poise.errors import UsageError
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
from poise.manage.run import Run
from poise.session.launch import (
    Kind,
    Watching,
    decide,
    first_task,
    prepared,
    running,
)
from poise.session.profiles import read_profile
from poise.session.writable import to_write
from poise.wire.records.recorded import Recorded
from poise.wire.records.samples import AgentSample

if TYPE_CHECKING:
    from poise.manage.observe.opentelemetry import Telemetry

_LOOK_EVERY = 0.2


def up_command(
    file: Annotated[Path, typer.Argument(help="The robot file.")],
    task: Annotated[
        str | None, typer.Option(help="The task; else the file's first.")
    ] = None,
    placement: Annotated[
        Kind, typer.Option(help="auto: Poise decides; static: home computers.")
    ] = "auto",
    journal: Annotated[
        Path | None, typer.Option(help="File for the journal (SQLite).")
    ] = None,
    metrics: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="TCP port for Prometheus, on this computer."
        ),
    ] = None,
    otel: Annotated[
        str | None, typer.Option(help="URL of an OpenTelemetry collector (OTLP/HTTP).")
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            help="File for what agents tell of what is used.", callback=to_write
        ),
    ] = None,
) -> None:
    """Start a robot and keep it running until Ctrl-C or `poise stop`.

    Meanwhile `poise status`, `move`, `replace` and `balance` work on it.

    Example: poise up robot.yaml --task fetch
    """
    console = Console(highlight=False)
    robot = prepared(file, console.print)
    chosen = task or first_task(robot)
    decision = decide(robot, chosen, placement)
    send = telemetry() if otel is not None else None
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
        seen = Seen(estimates, recording if record else None, console)
        watching = Watching(seen.take)
        up = stack.enter_context(
            running(robot, decision.placement, book, console.print, watching)
        )
        run = up.run
        if metrics is not None:
            address = ("127.0.0.1", metrics)
            server = MetricsServer(estimates, run.agents.statuses, address)
            stack.callback(server.close)
        if send is not None and otel is not None:
            to = send(robot.name, estimates, run.agents.statuses, otel)
            stack.callback(to.close)
        console.print(
            f"robot '{robot.name}' is up with task '{chosen}'; Ctrl-C ends it"
        )
        manager = _Manager(run, chosen, estimates)
        while not manager.is_stopping:
            control_server.serve(manager.answer, _LOOK_EVERY)
            run.raise_on_lost()
            if up.world is not None and up.world.has_ended():
                seen.end()
        console.print("stopping")


def telemetry() -> type[Telemetry]:
    """Return the class that sends metrics; UsageError when its extra is missing."""
    try:
        from poise.manage.observe.opentelemetry import Telemetry
    except ImportError as error:
        raise UsageError(
            f"--otel needs OpenTelemetry: pip install 'poise[otel]' ({error})"
        ) from error
    return Telemetry


class Seen:
    """Takes what agents tell of what is used."""

    def __init__(
        self, estimates: Estimates, recording: Recording | None, console: Console
    ) -> None:
        self._estimates = estimates
        self._recording = recording
        self._console = console
        self._has_ended = False

    def end(self) -> None:
        """Take no more: without a simulated world sensors are silent."""
        if not self._has_ended:
            self._has_ended = True
            self._console.print(
                "the simulated world has ended: estimates stay as they are"
            )

    def take(self, sample: AgentSample) -> None:
        """Estimate, keep, and say when a demand has shifted."""
        if self._has_ended:
            return
        if self._recording is not None:
            self._recording.add(sample)
        for name, drift in self._estimates.take(sample):
            self._console.print(
                f"[yellow]'{name}' needs {drift.after:.1%} of a core now, "
                f"{drift.before:.1%} before[/]"
            )


class _Manager:
    """Answers what is asked of a running robot."""

    def __init__(self, run: Run, task: str, estimates: Estimates) -> None:
        self._run = run
        self._estimates = estimates
        self._task = task
        self.is_stopping = False

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
                self.is_stopping = True
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
