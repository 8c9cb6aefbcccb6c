"""Whether a migration's targets still come nearer to being ready."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping

from msgspec import Struct

from poise.errors import RunError
from poise.manage.agent_connections.statuses import (
    components_of,
    cut_links,
    keeping_ports,
)
from poise.manage.deploy.incarnation import Incarnation
from poise.manage.deploy.running_components import RunningComponents

STALL_LIMIT = 2.0
"""A preparation that makes no progress for so long has failed [s]."""


class Stall:
    """Notices when nothing goes on any more. Use it for one preparation."""

    def __init__(
        self,
        run: RunningComponents,
        targets: Collection[Incarnation],
        clock: Callable[[], float] = time.monotonic,  # a time that never goes back [s]
    ) -> None:
        self._run = run
        self._targets = targets
        self._missing: list[str] = []
        self._clock = clock
        self._since = clock()

    def look(self) -> None:
        """Raise RunError when nothing came nearer for `STALL_LIMIT`.

        Users' code that is imported or configured may take longer.
        """
        now, missing = self._clock(), self._run.missing(self._targets)
        if missing != self._missing or self._is_configuring():
            self._missing, self._since = missing, now
        elif now > self._since + STALL_LIMIT:
            text = f"nothing goes on since {STALL_LIMIT:g} s"
            raise RunError(f"{text}: {'; '.join(missing)}")

    def _is_configuring(self) -> bool:
        """Return whether a target is being started, imported or configured."""
        current, container_of = self._run.current(), self._run.layout.container_of
        wanted = {(t.component, t.epoch) for t in self._targets}
        places = {(t.computer, container_of(t.component)) for t in self._targets}
        states = {(c.name, c.epoch): c.state for c in components_of(current)}
        return any(states.get(each) == "unconfigured" for each in wanted) or any(
            health.state == "starting" and (computer, health.name) in places
            for computer, status in current.items()
            for health in status.health
        )


class LateConnector(Struct, frozen=True):
    """A connector whose ends do not reach each other."""

    why: str  # in words
    keep: int  # how many messages its subscriber keeps


def late_connectors(
    run: RunningComponents,
    sources: Iterable[Incarnation],
    others: Mapping[str, Incarnation],
) -> dict[str, LateConnector]:
    """Return the connectors of components that migrate over which data is late."""
    moving = {each.component: each for each in sources}
    placed = {**others, **moving}
    unreached = run.unreached_connectors(placed)
    keeps = keeping_ports(run.agents.statuses())
    late = {}
    for connector in run.layout.connectors_at(moving, placed):
        if (why := unreached.get(str(connector))) is None:
            continue
        ends = [placed[end.component] for end in connector.between]
        subscriber = connector.between[1]
        keep = keeps.get((subscriber.component, subscriber.port))
        if keep is None:
            why += f"; '{subscriber}' has no `keep`, so nothing may be lost"
        if keep is None or run.unresponsive(ends):
            raise RunError(f"connector '{connector}' cannot be drained: {why}")
        late[str(connector)] = LateConnector(why, keep)
    return late


def raise_on_cut_state(
    run: RunningComponents,
    sources: Iterable[Incarnation],
    targets: Iterable[Incarnation],
) -> None:
    """Raise RunError when a state would have to cross a link that is cut."""
    cut = cut_links(run.agents.statuses())
    to = {each.component: each.computer for each in targets}
    for source in sources:
        between = sorted({source.computer, to.get(source.component, source.computer)})
        if frozenset(between) in cut:
            raise RunError(
                f"link '{'-'.join(between)}' is cut: the state of component "
                f"'{source.component}' cannot cross it"
            )
