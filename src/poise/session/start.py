"""Starts a robot's components on its computers, and leaves nothing behind.

Here the parts are wired together: computers with their agents, the simulated world,
and the manager's run.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping

from msgspec import Struct

from poise.clock import SystemClock
from poise.errors import RobotError
from poise.manage.agents import Agents
from poise.manage.journal import Journal
from poise.manage.run import Run
from poise.model.robot import Robot
from poise.session.computers import Computers, computers_of
from poise.session.say import Check, Say, nothing
from poise.session.simulator import SimulatorProcess, world_of
from poise.session.temporary_folders import scratch_folder
from poise.wire.records.samples import SAMPLE_EVERY, AgentSample

AGENT_LIMIT = 20.0
"""All agents are there within this time [s]."""


class Started(Struct, frozen=True):
    """A robot that runs, with what it runs on."""

    run: Run
    computers: Computers
    world: SimulatorProcess | None


class Sampling(Struct, frozen=True):
    """Who takes samples of what components use, how often [s]; and snapshots' sizes.

    `take` is called on a thread of its own and must not block, and only while all
    components are at work: who starts or ends uses next to nothing.
    """

    take: Callable[[AgentSample], object] | None = None
    every: float = SAMPLE_EVERY
    weigh: bool = False


@contextlib.contextmanager
def started(
    robot: Robot,
    placement: Mapping[str, str],
    journal: Journal,
    say: Say,
    sampling: Sampling | None = None,
    check: Check = nothing,
) -> Iterator[Started]:
    """Start a robot's components on its computers; stop and remove all afterwards.

    Parameters
    ----------
    sampling
        Who takes the agents' samples; None: nobody.
    check
        Called several times a second while all starts and is watched; may raise to end
        that.

    Raises
    ------
    RobotError, RunError
        It could not be started; nothing is left.
    """
    _check_runnable(robot, placement)
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(scratch_folder("poise-run-"))
        look = sampling or Sampling()
        gate = _Gate(look.take or _forget)
        computers = stack.enter_context(
            computers_of(robot, folder / "computers", say, look.every)
        )
        world = stack.enter_context(world_of(robot, folder, check))
        agents = stack.enter_context(
            Agents(
                robot.name,
                computers.endpoints,
                SystemClock(),
                gate.take if look.take else None,
                lease=computers.lease,
            )
        )

        def look_around() -> None:
            check()
            computers.raise_if_ended()

        agents.wait_alive(computers.endpoints, AGENT_LIMIT, look_around)
        run = Run(robot, placement, agents, journal, str(folder), weigh=look.weigh)
        say(f"starting {len(placement)} components")
        stack.enter_context(_running(run, check))
        stack.enter_context(gate)
        yield Started(run, computers, world)


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
def _running(run: Run, check: Check) -> Iterator[None]:
    try:
        run.check = check
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
