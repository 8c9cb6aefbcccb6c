"""A component's ends of its connectors: outlets for what goes, inboxes for what comes.

They stay while paths change: connectors are joined to them, and a move looks at them.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from poise.errors import Timeout
from poise.runtime._calls import ComponentCounters
from poise.runtime.component.component import Component
from poise.runtime.component.ports import Port, Published, Queue, methods_of
from poise.runtime.connectors.sender import Facade, Sender, refusing
from poise.runtime.execution.connector_counters import Counts
from poise.runtime.execution.exclusion import Exclusion
from poise.runtime.execution.mailbox import Entry, Feed, Inbox, Mailbox

_ONEWAY = Queue("block", 64)
"""One-way calls that may wait for a component; then their callers wait."""


class Endpoints:
    """The ends at the ports of one incarnation of a component.

    Parameters
    ----------
    name
        The component's.
    exclusion
        What callers enter.
    counters
        Where what comes is counted.
    """

    def __init__(
        self,
        name: str,
        component: Component,
        ports: Mapping[str, Port],
        exclusion: Exclusion,
        counters: ComponentCounters,
    ) -> None:
        self.component = component
        self.ports = ports
        self.exclusion = exclusion
        self.mailbox = Mailbox(counters)
        self.inboxes = {
            port.name: Inbox(port.name, port.queue or _ONEWAY)
            for port in ports.values()
            if port.kind in {"subscribes", "provides"}
        }
        self.senders: dict[str, Sender] = {}
        self._name = name
        self._marks: dict[str, int] = {}
        self._marked = threading.Condition()
        self._letting = threading.Lock()
        self._is_unbounded = False
        for port in ports.values():
            self._disconnect(port)

    def sender(self, name: str, port: Port, limit: float) -> Sender:
        """Return the end of a connector at a published or required port."""
        if name not in self.senders:
            facade = None
            if port.kind == "requires":
                facade = getattr(self.component, port.name)
            exclusion = self.exclusion if self.component.reentrant else None
            self.senders[name] = Sender(name, port, facade, limit, exclusion)
            self._rewire(port)
        return self.senders[name]

    def drop_sender(self, name: str) -> None:
        """Close the end of a connector."""
        sender = self.senders.pop(name)
        sender.close()
        self._rewire(sender.port)

    def feed(self, port: str, counts: Counts, /) -> Feed:
        """Return the way into a port's queue for the connector of `counts`."""
        return Feed(self.mailbox, self.inboxes[port], counts)

    def preload(self, port: str, entry: Entry) -> None:
        """Queue what waited for the incarnation before; call it before `activate`."""
        inbox = self.inboxes[port]
        inbox.set_unbounded(unbounded=True)
        self.feed(port, Counts()).put(entry)

    def is_empty(self) -> bool:
        """Return whether no message and no one-way call waits."""
        return not any(inbox.waiting() for inbox in self.inboxes.values())

    def note_marker(self, connector: str, number: int, /) -> None:
        """Take note that all that was sent before this mark has come."""
        with self._marked:
            self._marks[connector] = number
            self._marked.notify_all()

    def wait_markers(self, marks: Mapping[str, int], limit: float) -> None:
        """Wait until these marks came, by connector.

        Nothing that is under way meanwhile waits for room: the component may be unable
        to take it because it waits itself for the one that moves.

        Raises
        ------
        Timeout
            They did not within `limit` [s].
        """

        def missing() -> list[str]:
            return [c for c, mark in marks.items() if self._marks.get(c) != mark]

        with self._with_room(), self._marked:
            if not self._marked.wait_for(lambda: not missing(), limit):
                raise Timeout(
                    f"component '{self._name}': messages are still under way over "
                    f"{', '.join(missing())}"
                )

    def set_unbounded(self, *, unbounded: bool) -> None:
        """Let what comes in without bounds, as nothing is taken out meanwhile."""
        with self._letting:
            self._is_unbounded = unbounded
            self._set_unbounded(unbounded=unbounded)

    def buffer_until_active(self) -> None:
        """Keep what it sends until `let_go`: it is not at work yet."""
        for sender in list(self.senders.values()):
            sender.buffer_until_active()

    def send_buffered(self) -> None:
        """Send what was kept back; harmless when repeated."""
        for sender in list(self.senders.values()):
            sender.send_buffered()

    @contextmanager
    def _with_room(self) -> Iterator[None]:
        with self._letting:
            self._set_unbounded(unbounded=True)
        try:
            yield
        finally:
            with self._letting:
                self._set_unbounded(unbounded=self._is_unbounded)

    def _set_unbounded(self, *, unbounded: bool) -> None:
        for inbox in self.inboxes.values():
            inbox.set_unbounded(unbounded=unbounded)

    def _disconnect(self, port: Port) -> None:
        if port.kind == "publishes":
            self._rewire(port)
        elif port.kind == "requires":
            what = f"{self._name}.{port.name}"
            facade = Facade(f"{what} ({port.type.__qualname__})")
            for name in methods_of(port.type):
                setattr(facade, name, refusing(what))
            setattr(self.component, port.name, facade)

    def _rewire(self, port: Port) -> None:
        """Let a published port send over all of its connectors."""
        if port.kind != "publishes":
            return
        sends = [o.send for o in self.senders.values() if o.port == port]

        def send_all(message: object) -> None:
            for send in sends:
                send(message)

        send = sends[0] if len(sends) == 1 else send_all
        setattr(self.component, port.name, Published(send, port.type))
