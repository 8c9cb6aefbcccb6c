"""A component's endpoints: senders for what it sends, a mailbox for what comes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

from poise.errors import Timeout
from poise.runtime._calls import ComponentCounters
from poise.runtime.component.component import Component
from poise.runtime.component.ports import Port, Published, Queue, methods_of
from poise.runtime.connectors.interface import Proxy, refusing
from poise.runtime.connectors.latest import Heard, LatestMessage, LatestMessages
from poise.runtime.connectors.sender import Sender
from poise.runtime.connectors.tap import ObservedPort
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.data_age import DataAges, SentChains
from poise.runtime.execution.exclusion import Exclusion
from poise.runtime.execution.mailbox import Mailbox

Timing = Callable[[Callable[..., Any], str], Callable[..., Any]]
"""What makes a method that counts its runs, of one that is called over a connector."""


class OvertakenSources:
    """Which incarnation of each source sent last; what a lost one sent may be late."""

    def __init__(self) -> None:
        self._latest: dict[str, int] = {}

    def note(self, connector: str, epoch: int) -> bool:
        """Note that a message came; return whether a later epoch has sent."""
        latest = self._latest.setdefault(connector, epoch)
        if epoch > latest:
            self._latest[connector] = epoch
        return epoch < latest

    def forget(self, connector: str, epoch: int) -> None:
        """Hear earlier incarnations again: this one is not joined any more."""
        if self._latest.get(connector) == epoch:
            del self._latest[connector]


_ONEWAY = Queue("block", 64)
"""One-way calls that may wait for a component; then their callers wait."""


class ComponentEndpoints:
    """The endpoints at the ports of one incarnation of a component."""

    def __init__(
        self,
        component: Component,
        epoch: int,
        ports: Mapping[str, Port],
        exclusion: Exclusion,
        counters: ComponentCounters,
        ages: DataAges,
        listeners: Mapping[str, Callable[[Any], None]] = MappingProxyType({}),
    ) -> None:
        self.ages = ages
        self.timing: Timing = lambda method, _: method
        self._listeners = listeners
        self.component = component
        self.exclusion = exclusion
        queues = {
            port.name: port.queue or _ONEWAY
            for port in ports.values()
            if port.kind in {"subscribes", "provides"}
        }
        self.mailbox = Mailbox(queues, counters)
        self.failure = ""
        self.overtaken = OvertakenSources()
        self.heard: dict[str, Heard] = {name: {} for name in queues}
        self.latest = LatestMessages(
            (name, LatestMessage(port.type, epoch))
            for name, port in ports.items()
            if port.latest
        )
        self.senders: dict[str, Sender] = {}
        self._observed: dict[str, ObservedPort] = {}
        self._name = component.name
        self._markers: dict[str, int] = {}
        self._marker_came = threading.Condition()
        for port in ports.values():
            self._disconnect(port)

    def sender(
        self, name: str, port: Port, limit: float, chains: SentChains | None = None
    ) -> Sender:
        """Return the sender of a connector at a published or required port."""
        if name not in self.senders:
            proxy = None
            if port.kind == "requires":
                proxy = getattr(self.component, port.name)
            exclusion = self.exclusion if self.component.reentrant else None
            latest = self.latest.get(port.name)
            sender = Sender(name, port, proxy, limit, exclusion, chains, latest)
            sender.on_observed = partial(self._rewire, port)
            self.senders[name] = sender
            self._rewire(port)
        return self.senders[name]

    def counts_of_calls(self) -> list[Counts]:
        """Return what is counted of the connectors over which it calls."""
        senders = list(self.senders.values())
        return [each.counts for each in senders if each.port.kind == "requires"]

    def remove_route(self, sender: Sender, key: str) -> None:
        """Close a route of a sender, and forget the sender with the last one."""
        sender.remove(key)
        if not sender.routes():
            del self.senders[sender.name]
            self._rewire(sender.port)

    def observed(self, port: Port) -> ObservedPort:
        """Return a published port, to be looked at without a connector."""
        if port.name not in self._observed:
            observed = ObservedPort(port, self.latest.get(port.name))
            observed.on_observed = partial(self._rewire, port)
            self._observed[port.name] = observed
        return self._observed[port.name]

    def note_marker(self, connector: str, number: int, /) -> None:
        """Note that all that was sent before this marker has come."""
        with self._marker_came:
            self._markers[connector] = number
            self._marker_came.notify_all()

    def wait_markers(self, markers: Mapping[str, int], limit: float) -> None:
        """Wait up to `limit` [s] for markers; no message waits for room meanwhile."""

        def missing() -> list[str]:
            return [
                c for c, marker in markers.items() if self._markers.get(c) != marker
            ]

        with self.mailbox.with_room(), self._marker_came:
            if not self._marker_came.wait_for(lambda: not missing(), limit):
                raise Timeout(
                    f"component '{self._name}': messages are still under way over "
                    f"{', '.join(missing())}"
                )

    def buffer_until_active(self) -> None:
        """Keep what it sends until `send_buffered`: it is not at work yet."""
        for sender in list(self.senders.values()):
            sender.buffer_until_active()

    def send_buffered(self) -> None:
        """Send what was buffered; harmless when repeated."""
        for sender in list(self.senders.values()):
            sender.send_buffered()

    def fail(self) -> None:
        """Drop and count what comes from now on, and let no caller wait."""
        self.failure = f"component '{self._name}' has failed"
        self.mailbox.close()

    def _disconnect(self, port: Port) -> None:
        if port.kind == "publishes":
            self._rewire(port)
        elif port.kind == "requires":
            what = f"{self._name}.{port.name}"
            make = getattr(self.component, "make_proxy", lambda _, what: Proxy(what))
            proxy = make(port.name, f"{what} ({port.type.__qualname__})")
            for name in methods_of(port.type):
                setattr(proxy, name, refusing(what))
            setattr(self.component, port.name, proxy)

    def _rewire(self, port: Port) -> None:
        """Let a published port send over all of its connectors."""
        if port.kind != "publishes":
            return
        sends = [o.sending() for o in self.senders.values() if o.port == port]
        if observed := self._observed.get(port.name):
            sends.append(observed.sending())
        send = _to_all(sends)
        if latest := self.latest.get(port.name):
            send = latest.numbering(send)
        if listener := self._listeners.get(port.name):
            send = _to_all([listener, send])
        setattr(self.component, port.name, Published(send, port.type))


def _to_all(sends: list[Callable[[Any], None]]) -> Callable[[Any], None]:
    def send_all(message: object) -> None:
        for send in sends:
            send(message)

    return sends[0] if len(sends) == 1 else send_all
