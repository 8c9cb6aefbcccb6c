"""The robots that run on this computer, and the names of what they consist of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Literal

from poise.errors import PoiseError
from poise.manage.agent_connections.statuses import connectors_of
from poise.manage.control_socket.agents_without_manager import robots_without_manager
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.control_socket.location import running_here
from poise.session.running_robots.running import Running

Thing = Literal["robots", "tasks", "computers", "components", "connectors"]
Robots = Mapping[str, RobotStatus | None]
"""Name -> status, by its agents where no manager answers; None: it is starting."""


def robots_here(name: str | None = None) -> Robots:
    """Return the robots that run here; only one if it is named.

    Raises
    ------
    UsageError
        The one that is named does not run.
    RunError
        It does not answer.
    """
    if name is not None:
        return {name: Running(name).status()}
    found: dict[str, RobotStatus | None] = {}
    managed = running_here()
    for each in managed:
        try:
            found[each] = Running(each).status()
        except PoiseError:
            found[each] = None
    return found | robots_without_manager(but=managed)


def names_of(robots: Robots, what: Thing) -> Iterator[str]:
    """Yield the names of all things of a kind, a `Thing`."""
    if what == "robots":
        yield from robots
    else:
        for status in filter(None, robots.values()):
            yield from sorted(set(_names(status, what)))


def _names(status: RobotStatus, what: str) -> Iterable[str]:
    if what == "tasks":
        return [each.name for each in status.tasks]
    if what == "connectors":
        return [end.name for end in connectors_of(status.computers)]
    return status.computers if what == "computers" else status.placement
