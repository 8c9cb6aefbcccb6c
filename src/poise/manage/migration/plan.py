"""Which incarnations go and come in a migration, and which steps that takes. Pure.

The steps of one round are taken at once, those of one container in their order here.
That order follows the phases: a step waits only for steps of an earlier kind, in
whatever container, so no two containers wait for each other.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from msgspec import Struct

from poise.manage.deployment import DeploymentPlan, Incarnation, name_of
from poise.manage.topological_order import levels
from poise.model.robot import Connector
from poise.wire.records.migration import Step, StepName

IDLE_LIMIT = 0.25
"""The longest wait for the end of a component's work, before it is paused [s]."""

PlacedStep = tuple[Incarnation, Step]
"""A step, and an incarnation whose container takes it."""


class MigrationPlan(Struct, frozen=True, kw_only=True):
    """Incarnations that go, and those that come instead.

    Parameters
    ----------
    what
        For people: ``component 'localiser'``.
    """

    what: str
    sources: tuple[Incarnation, ...]
    targets: tuple[Incarnation, ...]


class MigrationRounds:
    """The steps of one migration.

    Parameters
    ----------
    others
        All other incarnations that run, by component.
    calls
        Ends over which a component calls another: component and port.
    gateways
        Computer -> IP address and port of its gateway.
    """

    def __init__(
        self,
        layout: DeploymentPlan,
        plan: MigrationPlan,
        others: Mapping[str, Incarnation],
        calls: Collection[tuple[str, str]],
        gateways: Mapping[str, str],
    ) -> None:
        self._layout = layout
        self._gateways = gateways
        self._others = others
        self._sources = {each.component: each for each in plan.sources}
        self._targets = {each.component: each for each in plan.targets}
        self._is_move = self._sources.keys() == self._targets.keys()
        self._before = layout.connectors({*others, *self._sources})
        self._after = layout.connectors({*others, *self._targets})
        self._calls = calls

    def prepare(self) -> list[list[PlacedStep]]:
        """Return the rounds during which the sources still work."""
        sources, targets = self._sources.values(), self._targets.values()
        rounds = [
            [_step("offer state", s) for s in sources],
            [_step("pre-copy", t, sources=self._reached_from(t)) for t in targets],
            [_step("request state", t) for t in targets],
        ]
        if self._is_move:
            rounds.append([_step("await idle", s, limit=IDLE_LIMIT) for s in sources])
        return rounds

    def transfer(self) -> list[list[PlacedStep]]:
        """Return the rounds from the pause until the targets are ready.

        A move takes one round; more when callers must pause before their callees. An
        architecture that is replaced first works on all that was sent to it, in a round
        for each step of the way that messages take.
        """
        rounds: list[list[PlacedStep]] = []
        paused: set[str] = set()
        for level in self._levels():
            rounds.append([] if rounds else list(self._buffers()))
            if not self._is_move:
                rounds[-1] += self._drains_mailboxes(level, paused)
            rounds[-1] += [_step("pause", self._sources[name]) for name in level]
            paused |= set(level)
        targets = self._targets.values()
        rounds[-1] += self._drains_channels(self._before)
        rounds[-1] += [_step("send state", s) for s in self._sources.values()]
        rounds[-1] += [_step("restore state", t) for t in targets]
        rounds[-1] += [_step("activate", t) for t in targets]
        return rounds

    def resume(self) -> list[PlacedStep]:
        """Return the steps after which the targets work."""
        return [
            *(_step("resume", t) for t in self._targets.values()),
            *self._releases(self._after, self._targets, "release to targets"),
            *(_step("redirect", s) for s in self._sources.values()),
        ]

    def roll_back(self) -> list[PlacedStep]:
        """Return the steps after which the sources work again."""
        return [
            *(_step("roll back", s) for s in self._sources.values()),
            *self._releases(self._before, self._sources, "release to sources"),
        ]

    def _reached_from(self, target: Incarnation) -> dict[str, tuple[int, str]]:
        """Return the epochs of the sources, and where a target reaches them."""
        computer, gateways = target.computer, self._gateways
        return {
            name: (s.epoch, self._layout.address(s, computer, gateways))
            for name, s in self._sources.items()
        }

    def _buffered(self) -> list[Connector]:
        """Return the connectors from others to the sources that go to targets, too."""
        slots = {
            self._layout.slot_of(c) for c in self._into(self._after, self._targets)
        }
        return [
            connector
            for connector in self._into(self._before, self._sources)
            if self._layout.slot_of(connector) in slots
        ]

    def _into(
        self, connectors: list[Connector], ends: Mapping[str, Incarnation]
    ) -> list[Connector]:
        return [
            connector
            for connector in connectors
            if connector.between[0].component in self._others
            and connector.between[1].component in ends
        ]

    def _buffers(self) -> Iterator[PlacedStep]:
        for sender, connectors in self._by_sender(self._buffered()).items():
            yield sender, Step("buffer", connectors=tuple(map(name_of, connectors)))

    def _drains_mailboxes(
        self, names: Collection[str], paused: Collection[str]
    ) -> Iterator[PlacedStep]:
        """Let all arrive from senders that send no more, and be worked on."""
        into = [
            connector
            for connector in self._before
            if connector.between[1].component in names
            and connector.between[0].component in {*self._others, *paused}
        ]
        yield from self._drains_channels(into)
        for name in names:
            yield _step("drain mailbox", self._sources[name])

    def _drains_channels(self, connectors: list[Connector]) -> Iterator[PlacedStep]:
        """Wait for the markers over those connectors that get one.

        Others' connectors get one only when they lead to a target, too.
        """
        marked = set(map(name_of, self._buffered()))
        marked |= {
            name_of(c) for c in self._before if c.between[0].component in self._sources
        }
        by_receiver: dict[str, list[str]] = {}
        for connector in connectors:
            if name_of(connector) in marked:
                receiver = connector.between[1].component
                by_receiver.setdefault(receiver, []).append(name_of(connector))
        for name, names in by_receiver.items():
            receiving = self._sources.get(name) or self._others[name]
            yield _step("drain channels", receiving, connectors=tuple(names))

    def _releases(
        self,
        connectors: list[Connector],
        ends: Mapping[str, Incarnation],
        step: StepName,
    ) -> Iterator[PlacedStep]:
        buffered = {self._layout.slot_of(connector) for connector in self._buffered()}
        released = [
            connector
            for connector in self._into(connectors, ends)
            if self._layout.slot_of(connector) in buffered
        ]
        for sender, theirs in self._by_sender(released).items():
            keys = (
                self._layout.joined(
                    connector,
                    self._others[connector.between[0].component],
                    ends[connector.between[1].component],
                    self._gateways,
                ).key
                for connector in theirs
            )
            yield sender, Step(step, connectors=tuple(keys))

    def _by_sender(
        self, connectors: list[Connector]
    ) -> dict[Incarnation, list[Connector]]:
        """Return connectors by one sender for each container that they begin in."""
        found: dict[tuple[str, str], tuple[Incarnation, list[Connector]]] = {}
        for connector in connectors:
            sender = self._others[connector.between[0].component]
            container = self._layout.container_of(sender.component)
            key = (sender.computer, container)
            found.setdefault(key, (sender, []))[1].append(connector)
        return dict(found.values())

    def _levels(self) -> list[list[str]]:
        """Return the sources in the order in which they pause.

        A caller pauses before its callee, and in a replacement a publisher before its
        subscribers.
        """
        leads = (
            (connector.between[0].component, connector.between[1].component)
            for connector in self._before
            if not self._is_move or self._is_call(connector)
        )
        return levels(self._sources, leads)

    def _is_call(self, connector: Connector) -> bool:
        source = connector.between[0]
        return (source.component, source.port) in self._calls


def _step(name: StepName, taker: Incarnation, **more: Any) -> PlacedStep:  # noqa: ANN401, fields of `Step`
    return taker, Step(name, taker.component, taker.epoch, **more)
