"""Starts a robot's components on its computers, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

from msgspec import Struct

from poise.clock import SystemClock
from poise.errors import RobotError, RunError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import containers_left
from poise.manage.control_socket.location import AgentAddresses, forget, note
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.journal import Journal
from poise.model.robot import Robot
from poise.session.callbacks import Check, Say, log, nothing
from poise.session.launch.computers import Computers, computers_of
from poise.session.launch.temporary_folders import scratch_folder
from poise.session.launch.world import SimulatorProcess, world_of
from poise.units import counted
from poise.wire.records.status_records import SAMPLE_EVERY, AgentSample

_STEP = 0.2
MISSING_LIMIT = 2.0
"""The agents of a robot that is to be taken over are there within this time [s], or
their computers are lost."""
AGENT_LIMIT = 20.0
"""All agents are there within this time [s]."""


class Started(Struct, frozen=True):
    """A robot that runs, with what it runs on."""

    run: RunningComponents
    computers: Computers
    world: SimulatorProcess | None

    def watch(
        self,
        seconds: float,
        meanwhile: Callable[[float], object] = lambda _: None,
        is_over: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Let it run for `seconds`; return whether the simulated world ended first."""
        last, end = time.monotonic(), time.monotonic() + seconds
        while (left := end - last) > 0:
            self.run.watch(min(left, _STEP))
            self.computers.look()
            now = time.monotonic()
            meanwhile(now - last)
            last = now
            if is_over():
                return False
            if self.world is not None and self.world.has_ended():
                return True
        return False


class Sampling(Struct, frozen=True):
    """What takes samples, on another thread and without blocking, how often [s]."""

    take: Callable[[AgentSample], object] | None = None
    every: float = SAMPLE_EVERY
    weigh: bool = False


@contextlib.contextmanager
def started(  # noqa: PLR0913 - each is a choice of the caller
    robot: Robot,
    placement: Mapping[str, str],
    journal: Journal,
    say: Say,
    sampling: Sampling | None = None,
    check: Check = nothing,
    *,
    use_kept: bool = False,
    begin: Callable[[RunningComponents], object] | None = None,
) -> Iterator[Started]:
    """Start a robot's components on its computers; stop and remove all afterwards."""
    _check_runnable(robot, placement)
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(scratch_folder("poise-run-"))
        look = sampling or Sampling()
        at_work = threading.Event()

        def take(sample: AgentSample) -> None:
            if look.take is not None and at_work.is_set():
                look.take(sample)

        computers = stack.enter_context(
            computers_of(
                robot, folder / "computers", say, look.every, use_kept=use_kept
            )
        )
        world = stack.enter_context(world_of(robot, folder, check))
        agents = stack.enter_context(
            Agents(
                robot.name,
                computers.endpoints,
                SystemClock(),
                take if look.take else None,
                lease=computers.lease,
            )
        )

        def look_around() -> None:
            check()
            computers.raise_if_ended()

        if begin is None or not _is_at_work(agents, computers.endpoints, look_around):
            agents.wait_alive(computers.endpoints, AGENT_LIMIT, look_around)
        run = RunningComponents(
            robot, placement, agents, journal, str(folder), weigh=look.weigh
        )
        if begin is None:
            say(f"starting {counted(len(placement), 'component')}")
        if computers.outlive_manager:
            note(AgentAddresses(robot.name, computers.endpoints))
            stack.callback(_forget_if_ended, robot.name, agents, computers.endpoints)
        stack.enter_context(_running(run, check, begin or RunningComponents.start))
        stack.callback(at_work.clear)
        at_work.set()
        yield Started(run, computers, world)


def _forget_if_ended(robot: str, agents: Agents, computers: Iterable[str]) -> None:
    """Forget where the agents are, unless something may still run there."""
    if not containers_left(agents.statuses(), computers):
        forget(robot)


def _is_at_work(
    agents: Agents, computers: Collection[str], look_around: Callable[[], object]
) -> bool:
    """Return whether components run; computers that are missing are lost then."""

    def is_there() -> bool:
        look_around()
        return agents.reached() >= set(computers)

    agents.wait_news(is_there, MISSING_LIMIT)
    if not any(status.containers for status in agents.statuses().values()):
        return False
    agents.go_on_without_missing()
    return True


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
def _running(
    run: RunningComponents, check: Check, begin: Callable[[RunningComponents], object]
) -> Iterator[None]:
    try:
        run.check = check
        begin(run)
        yield
    except BaseException:
        if run.has_taken_over and not run.is_over.is_set():
            run.leave()  # a robot at work goes on, whatever becomes of this manager
        # the first error is the one to raise; what it leaves on real computers is said
        try:
            stop(run)
        except RunError as left:
            log.warning("%s", left)
        raise
    stop(run)
