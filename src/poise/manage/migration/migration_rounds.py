"""Which incarnations go and come in a migration, and which steps that takes. Pure.

The steps of one round are taken at once, those of one container in their order here.
That order follows the phases: a step waits only for steps of an earlier kind, in
whatever container, so no two containers wait for each other.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

from poise.manage.deploy.deactivation import levels
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Incarnation
from poise.model.robot import Connector
from poise.wire.records.migration_records import Step, StepName

IDLE_LIMIT = 0.25
"""The longest wait for the end of a component's work, before it is paused [s]."""

PlacedStep = tuple[Incarnation, Step]
"""A step, and an incarnation whose container takes it."""
Round = list[PlacedStep]


class MigrationRounds:
    """The steps by which targets take the place of sources."""

    def __init__(  # noqa: PLR0913, all that runs
        self,
        layout: DeploymentLayout,
        sources: Iterable[Incarnation],
        targets: Iterable[Incarnation],
        others: Mapping[str, Incarnation],
        calls: Collection[tuple[str, str]],
        gateways: Mapping[str, str],
        *,
        lossy: Mapping[str, int] = {},
        away: Collection[str] = (),
    ) -> None:
        self._layout = layout
        self._lossy = lossy
        self._away = away
        self._gateways = gateways
        self._others = others
        self._calls = calls
        self._sources = {incarnation.component: incarnation for incarnation in sources}
        self._targets = {incarnation.component: incarnation for incarnation in targets}
        self._is_move = self._sources.keys() == self._targets.keys()
        self._before = layout.connectors({*others, *self._sources})
        into_sources = self._into(self._before, self._sources)
        into_targets = self._into(
            layout.connectors({*others, *self._targets}), self._targets
        )
        # from others to the sources, and by the same ends of others to the targets
        slots = set(map(layout.slot_of, into_sources))
        slots &= set(map(layout.slot_of, into_targets))
        self._from, self._to = (
            [connector for connector in into if layout.slot_of(connector) in slots]
            for into in (into_sources, into_targets)
        )

    def prepare(self) -> Round:
        """Return the round during which the sources still work."""
        sources, targets = self._sources.values(), self._targets.values()
        steps = [_step("offer state", s) for s in sources]
        steps += [_step("pre-copy", t, sources=self._reached_from(t)) for t in targets]
        steps += [_step("request state", t) for t in targets]
        if self._is_move:
            steps += [_step("await idle", s, limit=IDLE_LIMIT) for s in sources]
        return steps

    def pause_and_transfer(self) -> list[Round]:
        """Return the rounds from the pause until the targets are ready.

        A move takes one round; more when callers must pause before their callees. An
        architecture that is replaced first works on all that was sent to it, in a round
        for each step of the way that messages take.
        """
        rounds: list[Round] = []
        paused: set[str] = set()
        for level in self._levels():
            rounds.append([] if rounds else self._buffer())
            if not self._is_move:
                rounds[-1] += self._drain_mailboxes(level, paused)
            rounds[-1] += map(self._pause, level)
            paused |= set(level)
        targets = self._targets.values()
        rounds[-1] += self._drain_channels(self._before)
        rounds[-1] += [_step("send state", s) for s in self._sources.values()]
        rounds[-1] += [_step("restore state", t) for t in targets]
        rounds[-1] += [_step("activate", t) for t in targets]
        return rounds

    def resume(self) -> Round:
        """Return the steps after which the targets work."""
        return [
            *(_step("resume", t) for t in self._targets.values()),
            # a release waits for the calls that are redirected
            *(_step("redirect", s) for s in self._sources.values()),
            *self._release("release to targets", self._to, self._targets),
        ]

    def roll_back(self) -> Round:
        """Return the steps after which the sources work again."""
        return [
            *(_step("roll back", s) for s in self._sources.values()),
            *self._release("release to sources", self._from, self._sources),
        ]

    def _reached_from(self, target: Incarnation) -> dict[str, tuple[int, str]]:
        """Return the epochs of the sources, and where a target reaches them."""
        computer, gateways = target.computer, self._gateways
        return {
            name: (s.epoch, self._layout.address(s, computer, gateways))
            for name, s in self._sources.items()
        }

    def _into(
        self, connectors: list[Connector], ends: Collection[str]
    ) -> list[Connector]:
        return [
            connector
            for connector in connectors
            if connector.between[0].component in self._others
            and connector.between[1].component in ends
        ]

    def _buffer(self) -> Round:
        return [
            (sender, Step("buffer", **self._named(connectors)))
            for sender, connectors in self._by_container(self._from)
        ]

    def _pause(self, name: str) -> PlacedStep:
        begin = [c for c in self._before if c.between[0].component == name]
        return _step("pause", self._sources[name], lossy=self._lossy_keys(begin))

    def _named(self, connectors: Collection[Connector]) -> dict[str, Any]:
        """Return what a step says of connectors: the names, and which are lossy."""
        lossless = (str(c) for c in connectors if str(c) not in self._lossy)
        lossy = self._lossy_keys(connectors)
        return {"connectors": tuple(lossless), "lossy": lossy}

    def _lossy_keys(self, connectors: Iterable[Connector]) -> dict[str, int]:
        """Return the keys of lossy connectors, and what their subscribers keep."""
        before = {**self._others, **self._sources}
        return {
            self._layout.key_of(c, before): self._lossy[str(c)]
            for c in connectors
            if str(c) in self._lossy
        }

    def _drain_mailboxes(
        self, names: Collection[str], paused: Collection[str]
    ) -> Iterator[PlacedStep]:
        """Let all arrive from senders that send no more, and be worked on."""
        silent = {*self._others, *paused}
        yield from self._drain_channels(
            connector
            for connector in self._before
            if connector.between[1].component in names
            and connector.between[0].component in silent
        )
        for name in names:
            yield _step("drain mailbox", self._sources[name])

    def _drain_channels(self, connectors: Iterable[Connector]) -> Iterator[PlacedStep]:
        """Wait for markers; others send one only where they lead to a target, too."""
        by_receiver: dict[str, list[Connector]] = {}
        for connector in connectors:
            source, receiver = connector.between
            if source.component in self._sources or connector in self._from:
                by_receiver.setdefault(receiver.component, []).append(connector)
        for name, theirs in by_receiver.items():
            receiving = self._sources.get(name) or self._others[name]
            if receiving.computer not in self._away:
                yield _step("drain channels", receiving, **self._named(theirs))

    def _release(
        self,
        name: StepName,
        connectors: list[Connector],
        ends: Mapping[str, Incarnation],
    ) -> Iterator[PlacedStep]:
        placed = {**self._others, **ends}
        for sender, theirs in self._by_container(connectors):
            keys = tuple(self._layout.key_of(connector, placed) for connector in theirs)
            yield sender, Step(name, keys=keys)

    def _by_container(
        self, connectors: list[Connector]
    ) -> Iterable[tuple[Incarnation, list[Connector]]]:
        """Return connectors by a sender in each container that can take a step."""
        found: dict[tuple[str, str], tuple[Incarnation, list[Connector]]] = {}
        for connector in connectors:
            sender = self._others[connector.between[0].component]
            if sender.computer in self._away:
                continue
            home = self._layout.container_at(sender)
            found.setdefault(home, (sender, []))[1].append(connector)
        return found.values()

    def _levels(self) -> list[list[str]]:
        """Return the sources in the order in which they pause.

        A caller pauses before its callee, and in a replacement a publisher before its
        subscribers.
        """
        leads = (
            (source.component, target.component)
            for source, target in (connector.between for connector in self._before)
            if not self._is_move or (source.component, source.port) in self._calls
        )
        return levels(self._sources, leads)


def _step(name: StepName, taker: Incarnation, **more: Any) -> PlacedStep:  # noqa: ANN401, fields of `Step`
    return taker, Step(name, taker.component, taker.epoch, **more)
