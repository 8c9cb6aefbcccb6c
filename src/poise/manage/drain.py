"""Deactivates components from sources to targets, so that what was sent arrives."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import partial

from poise.manage.deployment import name_of
from poise.manage.run import REST_LIMIT, Run
from poise.manage.statuses import components_of, connectors_of
from poise.manage.topological_order import levels
from poise.wire.records.deployment import ConnectorStatus

ARRIVAL_LIMIT = 2.5
"""Messages of a source that was deactivated are processed within this time [s]:
containers report their counts once a second, agents twice."""


def drain(run: Run) -> None:
    """Deactivate all components, each when it has processed what was sent to it.

    Afterwards the agents' statuses hold the final counts. A component whose handler
    does not end, and a message that does not arrive, are not waited for any longer.

    Raises
    ------
    RunError
        A computer was lost.
    """
    leads = [
        (connector.between[0].component, connector.between[1].component)
        for connector in run.layout.connectors(run.placed)
    ]
    inactive: set[str] = set()
    for level in levels(run.placed, leads):
        inactive |= set(level)
        wanted = [
            each.with_goal("inactive") if each.component in inactive else each
            for each in run.placed.values()
        ]
        run.tell(wanted, run.computers())
        run.agents.wait_news(partial(_are_inactive, run, inactive), REST_LIMIT)
        fed = {target for source, target in leads if source in inactive} - inactive
        run.agents.wait_news(partial(_is_processed, run, fed), ARRIVAL_LIMIT)


def _are_inactive(run: Run, names: Collection[str]) -> bool:
    run.raise_on_lost()
    return not any(
        component.name in names and component.state == "active"
        for component in components_of(run.current())
    )


def _is_processed(run: Run, targets: Collection[str]) -> bool:
    run.raise_on_lost()
    return not unprocessed(run, targets)


def unprocessed(run: Run, targets: Collection[str]) -> dict[str, int]:
    """Return connector -> messages sent to `targets` that they have not processed."""
    ends: dict[str, list[ConnectorStatus]] = {}
    for end in connectors_of(run.agents.statuses()):
        ends.setdefault(end.name, []).append(end)
    wanted = {
        name_of(connector): connector.between[1].component
        for connector in run.layout.connectors(run.placed)
    }
    left = {name: _left(same) for name, same in ends.items()}
    return {
        name: count
        for name, count in left.items()
        if count > 0 and wanted.get(name) in targets
    }


def _left(ends: Iterable[ConnectorStatus]) -> int:
    """Return how many messages a connector's target has not processed."""
    sent = max((e.messages - e.drops for e in ends if e.end != "target"), default=0)
    taken = sum(e.wait.count + e.drops for e in ends if e.end != "source")
    return sent - taken
