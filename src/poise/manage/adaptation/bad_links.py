"""What cut and slow links cost a placement, and how the planner sees them. Pure.

A component whose connector crosses a cut link works in vain; over a slow one, for the
share of its work that is lost on the way, or waits for as long as the next takes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from math import nan

from msgspec import Struct
from msgspec.structs import replace

from poise.errors import UsageError
from poise.manage.adaptation.situation import Situation
from poise.manage.agent_connections.statuses import CUT
from poise.model.policy import LinkValues
from poise.model.robot import Connector, Link, Robot

_CUT_DISTANCE = 1e6
"""By this factor the planner takes the ends of a cut link to be further apart."""
_FAR = 1e-6
"""A delay of this much [s] counts as much as the distance itself."""
_LOST = 1e-5
"""So does the loss of this share."""


class LinkState(Struct, frozen=True, kw_only=True):
    """A link as it is now, by the heartbeats in both directions."""

    link: Link
    delay: float = 0.0  # one way [s]
    loss: float = 0.0  # the share of heartbeats that did not come
    cut: bool = False

    def __str__(self) -> str:
        """Return its name, as policies know it."""
        return "-".join(self.link.between)

    @property
    def extra(self) -> float:
        """The delay beyond what the robot file says [s]."""
        return max(0.0, self.delay - self.link.latency)

    def in_vain(self, rate: float) -> float:
        """Return the share of work that is in vain for a connector of a rate [1/s]."""
        return 1.0 if self.cut else min(1.0, self.loss + rate * self.extra)


def states_of(situation: Situation) -> Iterator[LinkState]:
    """Yield the links of a robot as they are."""
    for link in situation.robot.links:
        first, second = link.between
        sides = [
            status.links[there]
            for here, there in ((first, second), (second, first))
            if (status := situation.statuses.get(here)) and there in status.links
        ]
        if situation.unreached & {first, second} or not sides:
            yield LinkState(link=link)
            continue
        yield LinkState(
            link=link,
            delay=max(side.delay or 0.0 for side in sides),
            loss=max(side.loss for side in sides),
            cut=max(side.silent for side in sides) > CUT,
        )


def link_values(situation: Situation) -> Iterator[LinkValues]:
    """Yield what policies may ask of links."""
    traffic: dict[frozenset[str | None], float] = {}
    for connector in situation.robot.all_connectors():
        now = situation.traffic.get(connector.name)
        if now is not None:
            ends = _ends(connector, situation.placement)
            traffic[ends] = traffic.get(ends, 0.0) + now.traffic
    for state in states_of(situation):
        first, second = state.link.between
        status = situation.statuses.get(first)
        clock = status.clocks.get(second) if status else None
        is_known = situation.unreached.isdisjoint(state.link.between)
        carried = traffic.get(frozenset(state.link.between), 0.0)
        yield LinkValues(
            name=str(state),
            bandwidth=state.link.bandwidth,
            traffic=carried if is_known else nan,
            trip=clock.trip if clock and is_known else nan,
            latency=state.link.latency,
            delay=state.delay if is_known else nan,
            loss=state.loss if is_known else nan,
            cut=state.cut,
        )


def bad_links(situation: Situation) -> tuple[LinkState, ...]:
    """Return the links about which policies want a new plan."""
    return tuple(s for s in states_of(situation) if str(s) in situation.bad_links)


def crossing(
    situation: Situation, placement: Mapping[str, str], bad: Sequence[LinkState]
) -> Iterator[tuple[Connector, LinkState]]:
    """Yield the connectors of a placement that cross bad links, with the links."""
    links = {frozenset[str | None](state.link.between): state for state in bad}
    for connector in situation.robot.all_connectors():
        if (state := links.get(_ends(connector, placement))) is not None:
            yield connector, state


def wasted(
    situation: Situation, placement: Mapping[str, str], bad: Sequence[LinkState]
) -> float:
    """Return what components compute in vain because of bad links [cores]."""
    shares: dict[str, float] = {}
    for connector, state in crossing(situation, placement, bad):
        now = situation.traffic.get(str(connector))
        rate = max(connector.rate, now.rate if now else 0.0)
        for end in connector.between:
            before = shares.get(end.component, 0.0)
            shares[end.component] = max(before, state.in_vain(rate))
    demands = situation.robot_now.demands("cpu")
    return sum(demands[name] * share for name, share in shares.items())


def check_links(situation: Situation, component: str, computer: str) -> None:
    """Raise UsageError when a link is cut that a move needs."""
    cut = [state for state in states_of(situation) if state.cut]
    source = situation.placement.get(component)
    if not cut or source is None or situation.robot.component(component).command:
        return
    needs = {
        str(state): f"'{connector}' would cross it"
        for connector, state in crossing(
            situation, {**situation.placement, component: computer}, cut
        )
        if component in {end.component for end in connector.between}
    } | {
        str(state): "the component's state cannot cross it"
        for state in cut
        if {*state.link.between} == {source, computer}
    }
    if needs:
        why = "; ".join(f"link '{link}' is cut: {what}" for link, what in needs.items())
        raise UsageError(f"component '{component}' cannot move to '{computer}': {why}")


def reason(situation: Situation, bad: Sequence[LinkState]) -> str:
    """Return what crosses bad links now, for people; empty where none is bad."""
    if not bad:
        return ""
    across: dict[str, list[str]] = {str(state): [] for state in bad}
    for connector, state in crossing(situation, situation.placement, bad):
        across[str(state)].append(f"'{connector}'")
    return "".join(
        f"link '{state}' is {'cut' if state.cut else 'slow'}{_cross(names)}; "
        for state, names in zip(bad, across.values(), strict=True)
    )


def _cross(connectors: Sequence[str]) -> str:
    verb = "cross" if len(connectors) > 1 else "crosses"
    return f", and {' and '.join(connectors)} {verb} it" if connectors else ""


def with_bad_links(robot: Robot, bad: Sequence[LinkState]) -> Robot:
    """Return the robot with the ends of bad links as far apart as they seem now."""
    if not bad:
        return robot
    distances = {
        state.link.between: state.link.distance
        * (_CUT_DISTANCE if state.cut else 1 + state.extra / _FAR + state.loss / _LOST)
        for state in bad
    }
    costs = [c.cost for c in robot.all_connectors() if c.cost > 0]
    least = min(costs, default=1.0)
    links = (
        replace(link, distance=distances.get(link.between, link.distance))
        for link in robot.links
    )
    return replace(robot, links=tuple(links)).with_connectors(
        lambda c: c if c.cost else replace(c, overhead=least)
    )


def beyond_cuts(
    placement: Mapping[str, str], bad: Sequence[LinkState]
) -> Mapping[str, AbstractSet[str]]:
    """Return where components may not go: state cannot cross a cut link, either."""
    found: dict[str, set[str]] = {}
    for state in bad:
        if state.cut:
            first, second = state.link.between
            other = {first: second, second: first}
            for name, at in placement.items():
                if at in other:
                    found.setdefault(name, set()).add(other[at])
    return found


def _ends(connector: Connector, placement: Mapping[str, str]) -> frozenset[str | None]:
    source, target = connector.between
    return frozenset((placement.get(source.component), placement.get(target.component)))
