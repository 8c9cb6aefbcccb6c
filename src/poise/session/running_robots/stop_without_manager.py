"""Ends what a manager that was killed, or cut off, left running on real computers."""

from __future__ import annotations

from poise.clock import SystemClock
from poise.endpoint import Endpoint
from poise.errors import RunError, UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.journal import Journal
from poise.model.robot import Robot
from poise.wire.control_session import locator

REACH_LIMIT = 5.0
"""Agents are reached within this time [s], or count as out of reach."""


def stop_without_manager(robot: Robot) -> None:
    """End all containers of a robot on its real computers.

    Raises
    ------
    UsageError
        Its computers have no addresses: emulated ones end with their manager.
    RunError
        A manager is at work, or a computer is out of reach.
    """
    addresses = {c.name: c.address for c in robot.computers if c.address}
    if not addresses:
        raise UsageError(
            f"robot '{robot.name}' has no computer with an address: emulated ones end "
            "with their manager"
        )
    ends = {name: locator(Endpoint.parse(a)) for name, a in addresses.items()}
    with Agents(robot.name, ends, SystemClock()) as agents:
        agents.wait_news(lambda: agents.reached() == ends.keys(), REACH_LIMIT)
        reached = agents.reached()
        agents.claim(reached)
        journal = Journal(":memory:")
        RunningComponents(robot, {}, agents, journal, "").end_all("asked to stop it")
        journal.close()
    missing = ", ".join(sorted(ends.keys() - reached))
    if missing:
        raise RunError(
            f"out of reach: {missing}; what runs there goes on. "
            f"Stopped: {', '.join(sorted(reached)) or 'nothing'}"
        )
