"""Opens and closes the ends of connectors that lie in one container."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from msgspec import structs

from poise.clock import Elapsed
from poise.errors import RobotError, RunError, UsageError
from poise.runtime.component.error_report import traceback_of
from poise.runtime.component.ports import Port, PortKind
from poise.runtime.connectors.channel_route import ChannelRoute, ReceivingEnd
from poise.runtime.connectors.flow_control import Credit, CreditIssuer
from poise.runtime.connectors.interface import carries_messages
from poise.runtime.connectors.route import DirectRoute, NumberedRoute, Route
from poise.runtime.connectors.sender import Sender
from poise.runtime.connectors.tap import InputFile
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.data_age import RemoteClock, SentChains
from poise.runtime.hosting.runner import Runner
from poise.wire.address import Address
from poise.wire.connections.channel import Channel
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.connections.opening import CALLS, MESSAGES
from poise.wire.records.deployment_records import ConnectorSpec
from poise.wire.records.status_records import ConnectorStatus, Side

SENDING: AbstractSet[PortKind] = {"publishes", "requires"}
TAKING: AbstractSet[PortKind] = {"subscribes", "provides"}
"""The kinds of ports at the two ends of a connector."""

_SHOWN_ONCE_CLOSED = 2.0
"""The last counts of a connector are reported for so long after it was closed [s]."""

Runners = Mapping[tuple[str, int], Runner]
"""The incarnations of components in a container, by name and epoch."""


class OpenConnector:
    """What one connector has open in this container."""

    def __init__(self, spec: ConnectorSpec) -> None:
        self.spec = spec
        self.closing = ExitStack()
        self.route: Route | None = None
        self.sender: Sender | None = None
        self.counts: Counts = Counts()
        self.remote_clock = RemoteClock()

    def try_connect(self) -> bool:
        """Connect if needed; return whether the other end is there, if known."""
        return self.route is None or self.route.try_connect()

    def status(self, *, is_closed: bool = False) -> ConnectorStatus:
        """Return what was counted, and whether the other end is there or not needed."""
        self.remote_clock.update()
        end: Side = "target" if self.sender is None else "source"
        if self.spec.kind == "direct":
            end = "both"
        spec = self.spec
        ready = is_closed or self.try_connect()
        status = self.counts.status(spec.name, spec.key, spec.kind, end, ready=ready)
        if ready or self.route is None:
            return status
        return structs.replace(status, refusal=self.route.refusal)


class Wiring:
    """The connectors of a container."""

    def __init__(
        self,
        server: ConnectionServer,
        clock_offset: Callable[[str], Elapsed | None] = lambda _: None,
    ) -> None:
        self._server = server
        self._clock_offset = clock_offset
        self._open: dict[str, OpenConnector] = {}
        self._closed: list[tuple[float, OpenConnector]] = []
        self._troubles: dict[tuple[str, int], str] = {}

    def apply(
        self, specs: tuple[ConnectorSpec, ...], runners: Runners
    ) -> dict[tuple[str, int], str]:
        """Open the connectors of `specs`, close others; return faults by epoch."""
        wanted = {spec.key: spec for spec in specs}
        self._close_readdressed(wanted)
        known = {opened.sender for opened in self.open_connectors()}
        troubles: dict[tuple[str, int], str] = {}
        for key, spec in wanted.items():
            here = _ends_here(spec, runners)
            if key in self._open or not here:
                continue
            try:
                self._open[key] = self._join(spec, runners)
            # reading types runs users' code
            except Exception as error:  # noqa: BLE001
                text = f"connector {spec.name}: {traceback_of(error)}"
                troubles.update(dict.fromkeys(here, text))
        self._buffer_amid_a_move(known)
        for key in self._open.keys() - wanted.keys():
            spec = self._open[key].spec
            if _ends_here(spec, runners):  # they rest: they are neither gone nor moved
                self._closed.append((time.monotonic(), self._open[key]))
            self.shut(key)
        self._troubles = troubles
        return troubles

    def raise_on_trouble(self, component: str, epoch: int) -> None:
        """Raise RunError when a connector of an incarnation could not be opened."""
        if trouble := self._troubles.get((component, epoch)):
            raise RunError(f"component '{component}' cannot be joined: {trouble}")

    def sender(self, connector: str) -> Sender:
        """Return the sender of a connector, by its name."""
        for opened in self.open_connectors():
            if opened.sender and opened.spec.name == connector:
                return opened.sender
        raise UsageError(f"no connector '{connector}' begins in this container")

    def sender_by_key(self, key: str) -> Sender:
        """Return the sender that has a route with this key."""
        opened = self._open.get(key)
        if opened is None or opened.sender is None:
            raise UsageError(f"no connector '{key}' begins in this container")
        return opened.sender

    def with_messages(self, connectors: Iterable[str], target: Runner) -> set[str]:
        """Return those over which messages come to a target: not only calls."""
        only_calls = {
            opened.spec.name
            for opened in self.open_connectors()
            if opened.spec.target == target.spec.name
            and (port := target.ports.get(opened.spec.target_port)) is not None
            and not carries_messages(port)
        }
        return set(connectors) - only_calls

    def shut(self, key: str) -> None:
        """Take nothing more over a connector until `apply` joins it again."""
        if opened := self._open.pop(key, None):
            opened.closing.close()

    def connect(self) -> frozenset[str]:
        """Connect what can be; return the keys of connectors without another end."""
        return frozenset(
            opened.spec.key
            for opened in self.open_connectors()
            if not opened.try_connect()
        )

    def joined_inputs(
        self, component: str, epoch: int, silent: AbstractSet[str]
    ) -> dict[str, bool]:
        """Return subscribed port -> whether one not on a `silent` computer sends."""
        joined: dict[str, bool] = {}
        for opened in self.open_connectors():
            spec = opened.spec
            if (spec.target, spec.target_epoch) != (component, epoch):
                continue
            is_joined = spec.kind == "direct" or self._server.is_joined(spec.key)
            is_joined = is_joined and spec.source_computer not in silent
            joined[spec.target_port] = joined.get(spec.target_port, False) or is_joined
        return joined

    def status(self) -> tuple[ConnectorStatus, ...]:
        """Return the status of every open connector, and of what was closed lately.

        What is joined in another way by now, as after a move, is left out. A target
        counts on while its source moves, and says so once.
        """
        now, names = time.monotonic(), {c.spec.name for c in self._open.values()}
        self._closed = [
            (at, closed)
            for at, closed in self._closed
            if now - at < _SHOWN_ONCE_CLOSED and closed.spec.name not in names
        ]
        last = [closed.status(is_closed=True) for _, closed in self._closed]
        opened = self.open_connectors()
        latest = {each.counts: each for each in opened}
        shown = [c for c in opened if c.sender or latest[c.counts] is c]
        return (*(each.status() for each in shown), *last)

    def open_connectors(self) -> list[OpenConnector]:
        """Return what is open now; any thread may ask."""
        return list(self._open.values())

    def close(self) -> None:
        """Close every connector."""
        for opened in self._open.values():
            opened.closing.close()
        self._open.clear()

    def _close_readdressed(self, wanted: Mapping[str, ConnectorSpec]) -> None:
        """Close connectors to an agent that was started again, at another port."""
        for key, opened in list(self._open.items()):
            if key in wanted and wanted[key].address != opened.spec.address:
                self.shut(key)

    def _buffer_amid_a_move(self, known: AbstractSet[Sender | None]) -> None:
        """Buffer over new connectors to a moving component, after a restart."""
        for opened in self.open_connectors():
            sender = opened.sender
            if sender is not None and sender not in known:
                with contextlib.suppress(RunError):  # its target does not move
                    sender.buffer_for_move()

    def _join(self, spec: ConnectorSpec, runners: Runners) -> OpenConnector:
        opened = OpenConnector(spec)
        source = runners.get((spec.source, spec.source_epoch))
        target = runners.get((spec.target, spec.target_epoch))
        if spec.kind == "remote":
            far = spec.source_computer if source is None else spec.target_computer
            opened.remote_clock = RemoteClock(partial(self._clock_offset, far))
        with ExitStack() as undo:
            undo.callback(opened.closing.close)
            if source is not None:
                self._open_source(opened, source, target)
            elif target is not None:
                self._open_target(opened, target)
            undo.pop_all()
        return opened

    def _open_source(
        self, opened: OpenConnector, source: Runner, target: Runner | None
    ) -> None:
        spec = opened.spec
        port = _port(source, spec.source_port, SENDING)
        chains = None
        if spec.carries or spec.answers:
            chains = SentChains(source.ages, spec.carries, spec.answers)
        name = spec.slot or spec.name
        sender = source.endpoints.sender(name, port, spec.limit, chains)
        if target is not None:
            far = _port(target, spec.target_port, TAKING)
            route = NumberedRoute if port.latest else DirectRoute
            opened.route = route(spec, target.endpoints, far, sender)
            opened.closing.callback(_forget, spec, target)
        else:
            credit = Credit()
            credit.on_credit = sender.note_room
            if port.latest:
                credit.on_heard = lambda heard: sender.offer_latest(opened.route, heard)
            use = CALLS if port.kind == "requires" else MESSAGES
            channel = Channel(
                spec.key,
                Address.parse(spec.address),
                self._server.folder,
                use,
                credit.note_credit,
                credit.request,
            )
            opened.route = ChannelRoute(
                spec, port, channel, credit, opened.remote_clock, source.lease
            )
        opened.sender = sender
        opened.counts = sender.counts
        sender.add(spec.key, opened.route)
        opened.closing.callback(source.endpoints.remove_route, sender, spec.key)

    def _open_target(self, opened: OpenConnector, target: Runner) -> None:
        spec = opened.spec
        port = _port(target, spec.target_port, TAKING)
        for other in self.open_connectors():
            is_same = (other.spec.name, other.sender) == (spec.name, None)
            if is_same and other.spec.target_epoch == spec.target_epoch:
                opened.counts = other.counts
        feed = target.endpoints.mailbox.feed(port.name, opened.counts)
        heard = target.endpoints.heard[port.name]
        issuer = CreditIssuer(spec.name, feed, heard)
        opened.closing.callback(issuer.close)
        opened.closing.callback(_forget, spec, target)
        handler = ReceivingEnd(
            spec=spec,
            target=target.endpoints,
            port=port,
            feed=feed,
            issuer=issuer,
            remote_clock=opened.remote_clock,
            lease=target.lease,
        ).handler()
        if spec.record:
            source = f"{spec.source}.{spec.source_port}"
            file = InputFile(Path(spec.record), source, port)
            opened.closing.callback(file.close)
            handler = file.handler(handler)
        self._server.open(spec.key, handler, opened.counts.refuse)
        opened.closing.callback(self._server.shut, spec.key)


def _ends_here(spec: ConnectorSpec, runners: Runners) -> list[tuple[str, int]]:
    """Return a connector's ends in this container; none if it cannot be joined."""
    ends = (spec.source, spec.source_epoch), (spec.target, spec.target_epoch)
    here = [end for end in ends if end in runners]
    # without one of a direct connector's ends, the other has nothing to join
    return here if len(here) >= (2 if spec.kind == "direct" else 1) else []


def _forget(spec: ConnectorSpec, target: Runner) -> None:
    target.endpoints.overtaken.forget(spec.name, spec.source_epoch)


def _port(runner: Runner, name: str, kinds: AbstractSet[PortKind]) -> Port:
    """Return a port that the check of the robot has seen, or its code of now lacks."""
    port = runner.ports.get(name)
    if port is None or port.kind not in kinds:
        has = ", ".join(f"{p.name} ({p.kind})" for p in runner.ports.values()) or "none"
        raise RobotError(
            f"component '{runner.spec.name}' has no port '{name}' that "
            f"{' or '.join(sorted(kinds))} (it has {has})"
        )
    return port
