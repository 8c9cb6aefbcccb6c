"""Which connectors of components that migrate are cut: nothing is waited for there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msgspec import Struct

from poise.errors import RunError
from poise.manage.agent_connections.statuses import cut_links, keeping_ports
from poise.manage.deploy.incarnation import Incarnation
from poise.manage.deploy.running_components import RunningComponents


class LateConnector(Struct, frozen=True):
    """A connector whose ends do not reach each other.

    Parameters
    ----------
    why
        In words.
    keep
        How many messages its subscriber keeps.
    """

    why: str
    keep: int


def late_connectors(
    run: RunningComponents,
    sources: Iterable[Incarnation],
    others: Mapping[str, Incarnation],
) -> dict[str, LateConnector]:
    """Return the connectors of components that migrate over which data is late.

    Parameters
    ----------
    others
        All other incarnations that run, by component.

    Raises
    ------
    RunError
        One has an end that does not respond, or nothing sent over it may be lost.
    """
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
