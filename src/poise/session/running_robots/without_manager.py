"""Robots without a manager, because that was killed or is cut off: seen, and ended."""

from __future__ import annotations

from msgspec.msgpack import encode

from poise.clock import SystemClock
from poise.emulate import set_for
from poise.errors import RunError, UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import containers_left
from poise.manage.control_socket.agents_without_manager import NoManager, ask_agents
from poise.manage.control_socket.commands import StopCommand, StopReport
from poise.manage.control_socket.control_client import ask
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import STOP_LIMIT
from poise.manage.observe.deviations import last_numbers, new_faults
from poise.model.robot import Robot
from poise.session.arguments import check_robot
from poise.session.launch.computers import emulated_addresses, real_agents
from poise.session.render.status_tables import Status
from poise.wire.control_session import endpoint_of
from poise.wire.credentials import Role
from poise.wire.records.deployment_records import Deployment
from poise.wire.robots_here import AgentAddresses, forget, running_here

REACH_LIMIT = 5.0
"""Agents are reached within this time [s], or count as out of reach."""


def status_without_manager(robot: Robot) -> Status:
    """Return what the agents at the addresses of a robot say, whoever manages it.

    Raises
    ------
    UsageError
        Its computers have no addresses, and none are kept for it.
    RunError
        No agent says that something runs, or why that is not known.
    """
    addresses = _addresses(robot, "viewer")
    status = ask_agents(addresses, wants_all=True)
    if status is None:
        places = ", ".join(str(endpoint_of(e)) for e in addresses.endpoints.values())
        raise RunError(
            f"robot '{robot.name}' does not run: no agent at {places} says that it "
            "runs something of it"
        )
    return Status.of(status)


def stop_without_manager(robot: Robot) -> None:
    """Stop a robot through its manager, or else end all containers on its computers.

    Raises
    ------
    UsageError
        Its computers have no addresses, and none are kept for it.
    RunError
        A computer is out of reach.
    NoManager
        A manager is at work, and takes no commands from here.
    """
    addresses = _addresses(robot)
    try:
        remaining = ask(addresses, StopCommand(), StopReport).remaining
    except NoManager as error:
        if error.left is None:
            raise
    except UsageError:  # no agent says that something runs
        pass
    else:
        if remaining:
            raise RunError("\n".join(remaining))
        return
    stop_agents(addresses)


def stop_agents(addresses: AgentAddresses) -> None:
    """End all containers of a robot's agents, which obey no manager that is there."""
    ends = addresses.endpoints
    keys = addresses.credentials()
    with Agents(addresses.robot, ends, SystemClock(), keys=keys) as agents:
        agents.wait_news(lambda: agents.reached() == ends.keys(), REACH_LIMIT)
        reached = agents.reached()
        agents.claim(reached)
        late = _end_all(agents, reached)
    missing = ", ".join(sorted(ends.keys() - reached))
    if missing:
        raise RunError(
            f"out of reach: {missing}; containers that run there go on. "
            f"Stopped: {', '.join(sorted(reached)) or 'nothing'}"
        )
    forget(addresses.robot)
    if late:
        raise RunError(f"stopped, but: {'; '.join(late)}")


def _end_all(agents: Agents, computers: set[str]) -> list[str]:
    """End all containers of computers; return which did not end in time, in words."""
    before = last_numbers(agents.statuses())
    generations = {n: s.generation + 1 for n, s in agents.statuses().items()}
    # no standby of an agent that was out of reach starts anything again
    last, term = encode(Desired(is_stopped=True)), agents.manager.term
    for name in sorted(computers):
        nothing = Deployment(
            generation=generations[name],
            containers=(),
            desired=last,
            term=term,
            is_last=True,
        )
        agents.begin_deploy(name, nothing)

    def left() -> list[str]:
        now = agents.statuses()
        told = {n: s for n, s in now.items() if s.generation >= generations[n]}
        return containers_left(told, computers)

    if not agents.wait_news(lambda: not left(), STOP_LIMIT):
        raise RunError(f"{', '.join(left())} still ran {STOP_LIMIT:g} s after the stop")
    return new_faults(before, agents.statuses())


def _addresses(robot: Robot, *also: Role) -> AgentAddresses:
    """Return where a robot's agents are, by its file or on computers kept for it."""
    check_robot(robot)
    if not robot.is_emulated:
        return real_agents(robot, *also)
    kept = set_for(robot)
    if kept is None and robot.name in running_here():
        raise UsageError(
            f"robot '{robot.name}' runs here, on computers that its manager emulates: "
            f"give --robot {robot.name} instead of its file"
        )
    if kept is None:
        raise UsageError(
            f"robot '{robot.name}' has no computer with an address, and `poise "
            "emulate` keeps none for it: components on emulated ones have ended"
        )
    return emulated_addresses(robot.name, kept.computers)
