"""Which robots run here, and what they consist of, for people."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType
from rich.text import Text

from poise.manage.agent_connections.statuses import components_of, connectors_of
from poise.session.render.tables import NamedRows, table
from poise.session.running_robots.local_robots import Robots


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
        states = {c.name: c.state for c in components_of(status.computers)}
        rows = table("component", "computer", "state")
        unknown = status.not_known()
        for component, computer in sorted(status.placement.items()):
            state = states.get(component, "not there")
            rows.add_row(
                component, computer, "unknown" if computer in unknown else state
            )
        yield rows
        kinds = {end.name: end.kind for end in connectors_of(status.computers)}
        joined = NamedRows("connector", "kind")
        for connector, kind in sorted(kinds.items()):
            joined.add_row(connector, kind)
        if kinds:
            yield joined
