"""Runs a task from nothing to a report, and leaves nothing behind.

Here the parts are wired together: a plan, computers with their agents, the simulated
world, and the manager's run.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Literal

from msgspec import Struct

from poise import plan
from poise.clock import SystemClock
from poise.errors import RobotError
from poise.manage.agents import Agents
from poise.manage.journal import Journal
from poise.manage.observe.report import (
    RunReport,
    clocks_of,
    component_reports,
    connector_reports,
    cpu_shares,
)
from poise.manage.run import Run
from poise.model import load
from poise.model.robot import Robot
from poise.session.check import find_problems
from poise.session.computers import Computers, Say, computers_of
from poise.session.profiles import profiled
from poise.session.recording import keeping
from poise.session.simulator import SimulatorProcess, world_of
from poise.session.temporary_folders import scratch_folder
from poise.wire.records.samples import SAMPLE_EVERY, AgentSample

Kind = Literal["auto", "static"]

AGENT_LIMIT = 20.0
"""All agents are there within this time [s]."""
_STEP = 0.2


class Decision(Struct, frozen=True):
    """Where each component goes, and how long that took to decide [s]."""

    kind: Kind
    placement: Mapping[str, str]
    seconds: float


def checked(path: Path) -> Robot:
    """Return the robot in a file whose code was checked too.

    Raises
    ------
    RobotError
        With all problems; nothing was started.
    """
    problems = find_problems(path)
    if problems:
        raise RobotError("\n".join(map(str, problems)))
    return load(path)


def prepared(path: Path, say: Say) -> Robot:
    """Return the checked robot in a file, with the demands that its profile gives.

    Parameters
    ----------
    say
        Told where demands are from, and which are missing or stale.

    Raises
    ------
    RobotError
        With all problems; nothing was started.
    """
    found = profiled(checked(path))
    for sentence in found.says:
        say(sentence)
    return found.robot


def first_task(robot: Robot) -> str:
    """Return the task that is run when none is named.

    Raises
    ------
    RobotError
        There is none.
    """
    if not robot.tasks:
        raise RobotError(
            f"robot '{robot.name}' has no task to run: add to its file, for instance, "
            "`tasks: {work: {actions: [{name: work, functions: [...]}]}}`"
        )
    return robot.tasks[0].name


def decide(robot: Robot, task: str, kind: Kind) -> Decision:
    """Decide where the components of a task run.

    Raises
    ------
    RobotError
        There is no placement; the message says why.
    """
    problem = plan.problem_of(robot, task)
    if kind == "static":
        return Decision(kind, plan.static(robot, problem), 0.0)
    result = plan.solve(problem)
    if not result.feasible:
        raise RobotError(f"task '{task}' has no placement: {result.reason}")
    return Decision(kind, result.placement, result.seconds)


def run_task(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str,
    decision: Decision,
    *,
    seconds: float,
    say: Say,
    report: Path | None = None,
    record: Path | None = None,
    meanwhile: Callable[[Run, float], None] | None = None,
) -> RunReport:
    """Run a task for `seconds` [s], or until the simulated world ends, and report.

    Parameters
    ----------
    say
        Called with a sentence at every step.
    report
        A folder for the journal; None: it is not kept.
    record
        A file for what is used and what is published between architectures; None: it
        is not kept.
    meanwhile
        Called a few times a second with the run and its time so far [s]; may move
        components.

    Raises
    ------
    RunError
        A component failed or a computer was lost; everything is down again.
    """
    with contextlib.ExitStack() as stack:
        journal = Journal(report / "journal.sqlite" if report else ":memory:")
        stack.callback(journal.close)
        journal.note("decided", f"task '{task}', {decision.kind} placement")
        kept = stack.enter_context(keeping(robot, decision.placement, record, say))
        watching = Watching(kept.samples.add) if record else None
        up = stack.enter_context(
            running(kept.robot, kept.placement, journal, say, watching)
        )
        say(f"running task '{task}' for up to {seconds:g} s")
        agents, world = up.run.agents, up.world
        up.computers.begin()
        begin, began = agents.statuses(), time.monotonic()
        while (left := began + seconds - time.monotonic()) > 0:
            up.run.watch(min(left, _STEP))
            up.computers.look()
            if meanwhile is not None:
                meanwhile(up.run, time.monotonic() - began)
            if world is not None and world.has_ended():
                break
        end, lasted = agents.statuses(), time.monotonic() - began
        return RunReport(
            robot=robot.name,
            task=task,
            placement=decision.kind,
            where=decision.placement,
            decision_seconds=decision.seconds,
            seconds=lasted,
            cpu_share=cpu_shares(robot, begin, end, up.computers.faster),
            components=component_reports(begin, end),
            connectors=connector_reports(end),
            faults=tuple(fault for status in end.values() for fault in status.faults),
            clocks=clocks_of(end),
            void=up.computers.end(),
            without=up.computers.without,
            simulation=world.result() if world else {},
        )


class Up(Struct, frozen=True):
    """A robot that runs, with what it runs on."""

    run: Run
    computers: Computers
    world: SimulatorProcess | None


class Watching(Struct, frozen=True):
    """Who takes samples of what components use, how often [s]; and snapshots' sizes.

    `take` is called on a thread of its own and must not block, and only while all
    components are at work: who starts or ends uses next to nothing.
    """

    take: Callable[[AgentSample], object] | None = None
    every: float = SAMPLE_EVERY
    weigh: bool = False


@contextlib.contextmanager
def running(
    robot: Robot,
    placement: Mapping[str, str],
    journal: Journal,
    say: Say,
    watching: Watching | None = None,
) -> Iterator[Up]:
    """Start a robot's components on its computers; stop and remove all afterwards.

    Parameters
    ----------
    watching
        Who takes the agents' samples; None: nobody.

    Raises
    ------
    RobotError, RunError
        It could not be started; nothing is left.
    """
    _check_runnable(robot, placement)
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(scratch_folder("poise-run-"))
        look = watching or Watching()
        gate = _Gate(look.take or _forget)
        computers = stack.enter_context(
            computers_of(robot, folder / "computers", say, look.every)
        )
        world = stack.enter_context(world_of(robot, folder))
        agents = stack.enter_context(
            Agents(
                robot.name,
                computers.endpoints,
                SystemClock(),
                gate.take if look.take else None,
                lease=computers.lease,
            )
        )
        agents.wait_alive(computers.endpoints, AGENT_LIMIT, computers.raise_if_ended)
        run = Run(robot, placement, agents, journal, str(folder), weigh=look.weigh)
        say(f"starting {len(placement)} components")
        stack.enter_context(_started(run))
        stack.enter_context(gate)
        yield Up(run, computers, world)


class _Gate:
    """Lets samples through while its `with` lasts."""

    def __init__(self, take: Callable[[AgentSample], object]) -> None:
        self._take = take
        self._is_open = False

    def __enter__(self) -> None:
        self._is_open = True

    def __exit__(self, *_: object) -> None:
        self._is_open = False

    def take(self, sample: AgentSample) -> None:
        """Hand a sample on, or let it go."""
        if self._is_open:
            self._take(sample)


def _check_runnable(robot: Robot, placed: Iterable[str]) -> None:
    """Raise RobotError when components are described for planning only."""
    wanted = set(placed)
    nothing = [
        component.name
        for component in robot.components()
        if component.name in wanted
        and not (component.implementation or component.command)
    ]
    if nothing:
        raise RobotError(
            f"components without `implementation` or `command`: {', '.join(nothing)}. "
            "They can be planned, but not run"
        )


@contextlib.contextmanager
def _started(run: Run) -> Iterator[None]:
    try:
        run.start()
        yield
    except BaseException:
        # what is left is ended with its computer; the first error is the one to tell
        with contextlib.suppress(Exception):
            run.stop()
        raise
    run.stop()


def _forget(_: AgentSample) -> None:
    """Keep nothing."""
