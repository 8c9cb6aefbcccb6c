"""Who goes, who comes, and which steps that takes. Pure.

The steps of one round are taken at once, those of one container in their order here.
That order is one of stages: what a step waits for is of an earlier stage, in whatever
container, so no two containers wait for each other.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from msgspec import Struct

from poise.manage.deployment import DeploymentPlan, Incarnation, name_of
from poise.manage.topological_order import levels
from poise.model.robot import Connector
from poise.wire.records.migration import (
    Activate,
    Await,
    Drain,
    Flush,
    Give,
    Hold,
    Lull,
    Offer,
    Open,
    Precopy,
    Release,
    Rest,
    Retire,
    Step,
    Take,
)

LULL_LIMIT = 0.25
"""So long is waited for the end of a component's work, before it moves [s]."""

Where = tuple[Incarnation, Step]
"""A step, and an incarnation whose container takes it."""


class MigrationPlan(Struct, frozen=True, kw_only=True):
    """Incarnations that go, and those that come instead.

    Parameters
    ----------
    what
        For people: ``component 'localiser'``.
    """

    what: str
    olds: tuple[Incarnation, ...]
    news: tuple[Incarnation, ...]


class Rounds:
    """The steps of one change.

    Parameters
    ----------
    others
        All other incarnations that run, by component.
    calls
        Ends over which a component calls another: component and port.
    number
        Tells this exchange, and its marks, from all others.
    gateways
        Computer -> IP address and port of its gateway.
    """

    def __init__(
        self,
        layout: DeploymentPlan,
        change: MigrationPlan,
        others: Mapping[str, Incarnation],
        calls: Collection[tuple[str, str]],
        number: int,
        gateways: Mapping[str, str],
    ) -> None:
        self._layout = layout
        self._gateways = gateways
        self._others = others
        self._olds = {each.component: each for each in change.olds}
        self._news = {each.component: each for each in change.news}
        self._is_move = self._olds.keys() == self._news.keys()
        self._number = number
        self._before = layout.connectors({*others, *self._olds})
        self._after = layout.connectors({*others, *self._news})
        self._calls = calls

    def prepare(self) -> list[list[Where]]:
        """Return the rounds while the old ones still serve."""
        number = self._number
        epochs = {name: old.epoch for name, old in self._olds.items()}
        offers: list[Where] = [
            (old, Offer(name, old.epoch, number)) for name, old in self._olds.items()
        ]
        joins: list[Where]
        joins = [
            (new, Precopy(name, new.epoch, number, epochs, self._addresses(new)))
            for name, new in self._news.items()
        ]
        asks: list[Where]
        asks = [(new, Await(name, new.epoch)) for name, new in self._news.items()]
        lulls: list[Where] = [
            (old, Lull(name, old.epoch, LULL_LIMIT)) for name, old in self._olds.items()
        ]
        return [offers, joins, asks, *([lulls] if self._is_move else [])]

    def hand_over(self) -> list[list[Where]]:
        """Return the rounds from the shut gate until the new ones are ready.

        A move takes one round; more when callers must come to rest before those whom
        they call. Who is replaced by others first works on all that was sent to it, in
        a round for each step of the way that messages take.
        """
        rounds: list[list[Where]] = []
        rested: set[str] = set()
        for level in self._levels():
            rounds.append([] if rounds else list(self._holds()))
            if not self._is_move:
                rounds[-1] += self._draining(level, rested)
            rounds[-1] += self._resting(level)
            rested |= set(level)
        rounds[-1] += self._flushes(self._before)
        rounds[-1] += [(o, Give(o.component, o.epoch)) for o in self._olds.values()]
        rounds[-1] += [(n, Take(n.component, n.epoch)) for n in self._news.values()]
        rounds[-1] += [(n, Activate(n.component, n.epoch)) for n in self._news.values()]
        return rounds

    def keep(self) -> list[Where]:
        """Return the steps that open the gate to the new ones."""
        return [
            *((new, Open(new.component, new.epoch)) for new in self._news.values()),
            *self._releases(self._after, self._news),
            *((old, Retire(old.component, old.epoch)) for old in self._olds.values()),
        ]

    def back(self) -> list[Where]:
        """Return the steps that open the gate to the old ones again."""
        return [
            *((old, Open(old.component, old.epoch)) for old in self._olds.values()),
            *self._releases(self._before, self._olds),
        ]

    def _addresses(self, new: Incarnation) -> dict[str, str]:
        """Return where a new one reaches the old ones, by component."""
        return {
            name: self._layout.address(old, new.computer, self._gateways)
            for name, old in self._olds.items()
        }

    def _held(self) -> list[Connector]:
        """Return the connectors from others to the old ones that go to new ones."""
        slots = {self._layout.slot_of(c) for c in self._into(self._after, self._news)}
        return [
            connector
            for connector in self._into(self._before, self._olds)
            if self._layout.slot_of(connector) in slots
        ]

    def _into(
        self, connectors: list[Connector], targets: Mapping[str, Incarnation]
    ) -> list[Connector]:
        return [
            connector
            for connector in connectors
            if connector.between[0].component in self._others
            and connector.between[1].component in targets
        ]

    def _holds(self) -> Iterator[Where]:
        for source, connectors in self._by_source(self._held()).items():
            yield source, Hold(tuple(map(name_of, connectors)), self._number)

    def _resting(self, names: Collection[str]) -> Iterator[Where]:
        for name in names:
            old = self._olds[name]
            yield old, Rest(name, old.epoch, self._number)

    def _draining(
        self, names: Collection[str], rested: Collection[str]
    ) -> Iterator[Where]:
        """Let all come that was sent by those who send no more, and be worked on."""
        into = [
            connector
            for connector in self._before
            if connector.between[1].component in names
            and connector.between[0].component in {*self._others, *rested}
        ]
        yield from self._flushes(into)
        for name in names:
            yield self._olds[name], Drain(name, self._olds[name].epoch)

    def _flushes(self, connectors: list[Connector]) -> Iterator[Where]:
        """Wait until all has arrived over these that went to the old ones or from them.

        Only what leads to a new one, too, was held and so has a mark.
        """
        marked = set(map(name_of, self._held()))
        marked |= {
            name_of(c) for c in self._before if c.between[0].component in self._olds
        }
        by_target: dict[str, list[str]] = {}
        for connector in connectors:
            if name_of(connector) in marked:
                target = connector.between[1].component
                by_target.setdefault(target, []).append(name_of(connector))
        for name, names in by_target.items():
            one = self._olds.get(name) or self._others[name]
            yield one, Flush(name, one.epoch, tuple(names), self._number)

    def _releases(
        self, connectors: list[Connector], targets: Mapping[str, Incarnation]
    ) -> Iterator[Where]:
        held = {self._layout.slot_of(connector) for connector in self._held()}
        mine = [
            connector
            for connector in self._into(connectors, targets)
            if self._layout.slot_of(connector) in held
        ]
        for source, theirs in self._by_source(mine).items():
            keys = (
                self._layout.joined(
                    connector,
                    self._others[connector.between[0].component],
                    targets[connector.between[1].component],
                    self._gateways,
                ).key
                for connector in theirs
            )
            yield source, Release(tuple(keys))

    def _by_source(
        self, connectors: list[Connector]
    ) -> dict[Incarnation, list[Connector]]:
        """Return connectors by one source for each container that they begin in."""
        found: dict[tuple[str, str], tuple[Incarnation, list[Connector]]] = {}
        for connector in connectors:
            source = self._others[connector.between[0].component]
            container = self._layout.container_of(source.component)
            key = (source.computer, container)
            found.setdefault(key, (source, []))[1].append(connector)
        return dict(found.values())

    def _levels(self) -> list[list[str]]:
        """Return the old ones in the order in which they come to rest.

        Who calls one, or sends to it what it is to work on, rests before.
        """
        leads = (
            (connector.between[0].component, connector.between[1].component)
            for connector in self._before
            if not self._is_move or self._is_call(connector)
        )
        return levels(self._olds, leads)

    def _is_call(self, connector: Connector) -> bool:
        source = connector.between[0]
        return (source.component, source.port) in self._calls
