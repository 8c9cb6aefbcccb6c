"""In which order components become idle, so that calls and messages still arrive."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial

from poise.errors import RunError
from poise.manage.agent_connections.statuses import (
    Statuses,
    calling_ports,
    components_of,
)
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.observe.deviations import last_numbers, new_faults
from poise.wire.records.status_records import ENDING_LIMIT


def levels(names: Collection[str], leads: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Return `names`, each before all to which it leads.

    Those that lead to each other are in one level.

    `leads`: pairs of which the first leads to the second; also over others.
    """
    following: dict[str, set[str]] = {}
    for source, target in leads:
        following.setdefault(source, set()).add(target)
    reached = {name: _reached(name, following) for name in names}
    left, ordered = list(names), []
    while left:
        level = [
            name
            for name in left
            if all(
                name not in reached[other] or other in reached[name] for other in left
            )
        ]
        ordered.append(level)
        left = [name for name in left if name not in level]
    return ordered


def _reached(name: str, following: dict[str, set[str]]) -> set[str]:
    reached: set[str] = set()
    waiting = [name]
    while waiting:
        for target in following.get(waiting.pop(), ()):
            if target not in reached:
                reached.add(target)
                waiting.append(target)
    return reached


Leads = list[tuple[str, str]]
"""Pairs of components of which the first calls the second, or publishes to it."""

REST_LIMIT = 2.0
"""Components become inactive within this time [s], or are not waited for any longer,
unless they are amid `deactivate`. Containers are patient with a handler for half of
it."""
ARRIVAL_LIMIT = 2.5
"""Messages of a source that was deactivated are processed within this time [s]:
containers report their counts once a second, agents twice."""


def deactivate_callers(live: LiveRobot) -> None:
    """Make callers inactive before those whom they call: no call goes nowhere."""
    calls = calling_ports(live.agents.statuses())
    ends = [connector.between for connector in live.layout.connectors(live.placed)]
    leads = [
        (s.component, t.component) for s, t in ends if (s.component, s.port) in calls
    ]
    callees = {callee for _, callee in leads}
    if callees:
        next(inactive for inactive in _deactivate(live, leads) if callees <= inactive)


def drain(
    live: LiveRobot, unprocessed: Callable[[Statuses], Mapping[str, int]]
) -> None:
    """Deactivate all components, each when it has processed what was sent to it.

    Afterwards the agents' statuses hold the final counts. A handler that does not end,
    and a message that does not arrive, are not waited for any longer.

    `unprocessed`: connector -> messages sent over it that wait or are under way.
    """
    connectors = live.layout.connectors(live.placed)
    ends = {str(connector): connector.between for connector in connectors}
    leads = [(source.component, target.component) for source, target in ends.values()]

    def is_processed(fed: set[str]) -> bool:
        live.raise_on_lost()
        left = unprocessed(live.agents.statuses()).keys() & ends.keys()
        return fed.isdisjoint(ends[name][1].component for name in left)

    for inactive in _deactivate(live, leads):
        fed = {target for source, target in leads if source in inactive} - inactive
        live.agents.wait_news(partial(is_processed, fed), ARRIVAL_LIMIT)
    resting = live.desired.prefetched
    live.agents.wait_news(partial(_are_inactive, live, resting), REST_LIMIT)


def _deactivate(live: LiveRobot, leads: Leads) -> Iterator[set[str]]:
    """Make components inactive, each before those to which it leads; yield which."""
    inactive: set[str] = set()
    for level in levels(live.placed, leads):
        inactive |= set(level)
        why = f"{', '.join(sorted(level))}: callers end before those whom they call"
        live.commit(live.desired.aiming("inactive", inactive), why)
        if not live.agents.wait_news(
            partial(_are_inactive, live, inactive), REST_LIMIT
        ):
            live.agents.wait_news(partial(_have_ended, live, inactive), ENDING_LIMIT)
        yield inactive


def _are_inactive(live: LiveRobot, names: Collection[str]) -> bool:
    live.reconcile()
    live.raise_on_lost()
    known = {**live.desired.prefetched, **live.placed}
    places = [each for each in known.values() if each.component in names]
    return not maybe_active(places, live.computers(), live.current())


def _have_ended(live: LiveRobot, names: Collection[str]) -> bool:
    """Return whether components are inactive, or something else keeps them."""
    return _are_inactive(live, names) or not any(
        component.name in names and component.handler == "deactivate"
        for component in components_of(live.current())
    )


def maybe_active(
    places: Iterable[Incarnation], reached: Collection[str], current: Statuses
) -> list[str]:
    """Return the components on `reached` computers that may be active."""
    active = {c.name for c in components_of(current) if c.state == "active"}
    return [
        incarnation.component
        for incarnation in places
        if incarnation.computer in reached
        and (incarnation.computer not in current or incarnation.component in active)
    ]


RETURN_LIMIT = 3.0
"""A stop waits this long for computers that are out of reach [s]."""


def stop(live: LiveRobot) -> None:
    """Stop everything, callers first, on all computers that are reached or come back.

    Harmless when repeated. `live.remaining` says what did not end in time; after
    RunError, what still runs.
    """
    if live.is_left or live.desired.is_stopped:
        return
    try:
        _stop(live)
    except RunError as error:
        live.remaining = str(error)
        raise


def _stop(live: LiveRobot) -> None:
    agents, live.goes_on_without_lost = live.agents, True
    before = last_numbers(agents.statuses())
    with contextlib.suppress(RunError):  # it is only for quiet
        deactivate_callers(live)
    away = {computer.name for computer in live.robot.computers} - live.computers()
    live.end_all("the robot is stopped")
    if away:
        agents.wait_news(lambda: away <= live.computers(), RETURN_LIMIT)
        if not away.isdisjoint(live.computers()):
            live.end_all("computers that are back are stopped")
    unreached = [
        f"{sentence}; `poise stop --file FILE` ends it once '{name}' is reached"
        for name, sentence in live.unreached().items()
    ]
    if text := "; ".join([*new_faults(before, agents.statuses()), *unreached]):
        live.remaining = f"stopped, but: {text}"
        live.journal.note("failed", live.remaining)
    if unreached:
        raise RunError(live.remaining)
    live.journal.note("done", "everything stopped")
