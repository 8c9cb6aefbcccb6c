"""A manager that only tells, of a robot that is made up, how it is.

It imports internal modules: it answers in the place of a manager.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future

from poise.errors import UsageError
from poise.estimate.online import Estimate
from poise.estimate.profiles import ConnectorProfile
from poise.manage.control_socket.commands import (
    Command,
    JournalCommand,
    JournalEntries,
    Refusal,
    Result,
    RobotStatus,
    StatusCommand,
)
from poise.manage.control_socket.control_server import ControlServer
from poise.manage.journal import JournalEntry
from poise.manage.observe.estimates import DemandEstimate, Load
from poise.wire.records.request_records import ManagerId
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Summary,
    TimerStatus,
)

_CAPACITY = 4.0
_EACH = 40
"""So many components are on a computer."""


@contextlib.contextmanager
def told(robot: str, components: int) -> Iterator[Counter[type[Command]]]:
    """Answer on the control socket of a robot: all its figures change all the time.

    Yields how often was asked for what.
    """
    since = time.time()
    asked: Counter[type[Command]] = Counter()

    def submit(command: Command) -> Future[Result | Refusal]:
        future: Future[Result | Refusal] = Future()
        future.set_result(answer(command))
        return future

    def answer(command: Command) -> Result | Refusal:
        asked[type(command)] += 1
        match command:
            case StatusCommand():
                return status(robot, components, time.time() - since, since)
            case JournalCommand(after=after):
                entries = (JournalEntry(since, "decided", "it is made up", {}, 1),)
                return JournalEntries(entries if after < 1 else ())
        return Refusal.from_error(UsageError("this robot is made up"))

    with ControlServer(robot) as server:
        server.start(submit)
        yield asked


def status(robot: str, components: int, at: float, since: float) -> RobotStatus:
    """Return how the robot is.

    Parameters
    ----------
    at
        Time since it was started [s].
    since
        When that was [s since 1970].
    """
    names = [f"component-{n:03}" for n in range(components)]
    computers = max(2, components // _EACH)
    placement = {name: f"computer-{n % computers}" for n, name in enumerate(names)}
    pairs = [(a, names[(n + 1) % components]) for n, a in enumerate(names)]
    return RobotStatus(
        robot=robot,
        task="work",
        manager=ManagerId(
            key="k", user="user", host="host", pid=os.getpid(), since=since
        ),
        placement=placement,
        computers={
            computer: _agent(
                computer, [n for n in names if placement[n] == computer], at
            )
            for computer in sorted(set(placement.values()))
        },
        demand_estimates=tuple(
            DemandEstimate(
                component=name,
                computer=placement[name],
                expected=0.05,
                estimate=Estimate(mean=_figure(n, at, 0.1), p95=0.1, error=0.01),
            )
            for n, name in enumerate(names)
        ),
        loads={
            f"computer-{n}": Load(capacity=_CAPACITY, used=_figure(n, at, _CAPACITY))
            for n in range(computers)
        },
        traffic={
            f"{a}.out-{b}.in": ConnectorProfile(messages=_figure(n, at, 100), size=1e3)
            for n, (a, b) in enumerate(pairs)
        },
    )


def _agent(computer: str, names: list[str], at: float) -> AgentStatus:
    container = ContainerStatus(
        name="all",
        pid=1,
        components=tuple(_component(n, name, at) for n, name in enumerate(names)),
        connectors=tuple(_connector(name) for name in names),
    )
    return AgentStatus(
        computer=computer,
        generation=1,
        uptime=at,
        cpu=at,
        memory=int(_figure(1, at, 1e9)),
        containers=(container,),
    )


def _component(number: int, name: str, at: float) -> ComponentStatus:
    timer = TimerStatus(
        name="tick",
        period=0.1,
        deadline=0.1,
        releases=int(10 * at),
        missed=int(at) if number % 20 == 0 else 0,
        lateness=Summary(),
        duration=Summary(count=int(10 * at), p99=_figure(number, at, 0.1)),
    )
    return ComponentStatus(name=name, state="active", timers=(timer,))


def _connector(name: str) -> ConnectorStatus:
    to = f"component-{int(name.rpartition('-')[2]) + 1:03}"
    return ConnectorStatus(
        name=f"{name}.out-{to}.in", kind="remote", end="source", ready=True
    )


def _figure(number: int, at: float, most: float) -> float:
    """Return a figure between a tenth of the most and the most, new at each time."""
    return most * (0.1 + 0.9 * ((number * 0.37 + at * 0.11) % 1.0))
