"""The robots that run on this computer, and the names of what they consist of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from statistics import fmean, pstdev
from typing import Literal

from msgspec import Struct
from rich.console import RenderableType
from rich.text import Text

from poise.errors import PoiseError
from poise.manage.agent_connections.statuses import connectors_of
from poise.manage.control_socket.agents_without_manager import robots_without_manager
from poise.manage.control_socket.commands import RobotStatus
from poise.session.render.status_tables import component_table
from poise.session.render.tables import NamedRows
from poise.session.running_robots.running import Running
from poise.units import format_bytes, format_seconds
from poise.wire.robots_here import running_here

Thing = Literal["robots", "tasks", "computers", "components", "connectors"]
Robots = Mapping[str, RobotStatus | None]
"""Name -> status, by its agents where no manager answers; None: it is starting."""


def robots_here(name: str | None = None) -> Robots:
    """Return the robots that run here; only one if it is named."""
    if name is not None:
        return {name: Running(name).status()}
    found: dict[str, RobotStatus | None] = {}
    managed = running_here()
    for robot in managed:
        try:
            found[robot] = Running(robot).status()
        except PoiseError:
            found[robot] = None
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
        ends = connectors_of(status.computers)
        return [*(end.name for end in ends), *status.by_ros2]
    return status.computers if what == "computers" else status.placement


def listing(robots: Robots) -> Iterator[RenderableType]:
    """Yield each robot with its components and connectors."""
    if not robots:
        yield "no robot runs here; `poise up FILE` starts one"
    for name, status in robots.items():
        if status is None:
            yield f"robot '{name}' gives no status: it may be starting"
            continue
        if status.by_agents:
            yield Text(status.deviations[0].what, style="red")
        else:
            yield f"robot '{name}', task '{status.task}'"
        yield component_table(status)
        kinds = dict.fromkeys(status.by_ros2, "ROS 2")
        for computer, report in status.computers.items():
            for end in connectors_of({computer: report}):
                if computer not in status.not_known():
                    kinds[end.name] = end.kind
                kinds.setdefault(end.name, "unknown")
        joined = NamedRows("connector", "kind")
        for connector, kind in sorted(kinds.items()):
            joined.add_row(connector, kind)
        if kinds:
            yield joined


class Rate(Struct, frozen=True):
    """How often something came, and how regularly.

    Parameters
    ----------
    count
        How often it came.
    mean
        The rate [Hz]; 0 when it came less than twice.
    shortest, longest
        Time from one to the next [s].
    jitter
        Standard deviation of these times [s].
    missing
        How many more came whose moments are not known.
    size, largest
        Of those that left their container since the start: the median, and the most
        [bytes]; 0 when none did.
    """

    count: int = 0
    mean: float = 0.0
    shortest: float = 0.0
    longest: float = 0.0
    jitter: float = 0.0
    missing: int = 0
    size: float = 0.0
    largest: float = 0.0

    @classmethod
    def of(
        cls, times: Sequence[float], missing: int = 0, before: float | None = None
    ) -> Rate:
        """Return the rate of what came at these moments, and once `before` them [s]."""
        moments = sorted(times) if before is None else [before, *sorted(times)]
        gaps = [later - earlier for earlier, later in pairwise(moments)]
        if not gaps or not sum(gaps):
            return cls(len(times), missing=missing)
        return cls(
            len(times), 1 / fmean(gaps), min(gaps), max(gaps), pstdev(gaps), missing
        )

    def lines(self) -> Iterator[str]:
        """Yield it for people."""
        sizes = ""
        if self.largest:
            size, largest = map(format_bytes, (self.size, self.largest))
            sizes = f", {size} in the median, {largest} at most"
        if not self.mean:
            yield f"{self.count} in this time: no rate{sizes}"
            return
        shortest, longest, jitter = map(
            format_seconds, (self.shortest, self.longest, self.jitter)
        )
        yield (
            f"{self.mean:.4g} Hz, {shortest} to {longest} apart, jitter {jitter} "
            f"({self.count} times){sizes}"
        )
        if self.missing:
            yield f"{self.missing} more had no room to be noted: the rate is higher"
