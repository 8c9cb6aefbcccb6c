"""The sending ends of connectors: a route to one target, and a buffer during a move."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, NamedTuple

from poise.wire.records.deployment import ConnectorSpec

if TYPE_CHECKING:
    from poise.simulation.components.container import SimulatedContainer
    from poise.simulation.network.network import Stream

MOST_BUFFERED = 1000
Stamps = tuple[float, ...]
"""When the data of each chain that goes over a connector was made [s]."""
Answer = Callable[[Stamps | None], object]


class QueuedItem(NamedTuple):
    """A message or call with its number, or the marker of a migration.

    `answer` takes the stamps of what a call returns.
    """

    kind: Literal["message", "call", "marker"]
    number: int
    stamps: Stamps = ()
    answer: Answer | None = None


class Incoming(NamedTuple):
    """A message or call that waits for its component."""

    slot: str
    number: int
    spec: ConnectorSpec
    stamps: Stamps = ()
    answer: Answer | None = None


class SimulatedSender:
    """What a component sends over one slot, whichever target that leads to.

    Attributes
    ----------
    calls, messages
        How many went out.
    """

    def __init__(self, container: SimulatedContainer, spec: ConnectorSpec) -> None:
        self.spec = spec
        self.slot = spec.slot or spec.name
        self.is_buffering = False
        self.calls = self.messages = self.drops = 0
        self._container = container
        self._routes: dict[str, Stream] = {}
        self._buffer: deque[QueuedItem] = deque()

    def publish(self) -> None:
        """Send a message, or buffer it."""
        world = self._container.world
        self.messages += 1
        number = world.ledger.number(self.slot)
        self._put(QueuedItem("message", number, self._stamps()))

    def call(self, answer: Answer) -> None:
        """Ask the target; `answer` is called with None when its limit has passed."""
        container, limit = self._container, self.spec.limit
        ledger, scheduler = container.world.ledger, container.world.scheduler
        self.calls += 1
        is_over = False

        def end(stamps: Stamps | None) -> None:
            nonlocal is_over
            if not is_over:
                is_over = True
                timer.cancel()
                ledger.note_call(is_answered=stamps is not None)
                container.process.do(lambda: answer(stamps))

        timer = scheduler.at(scheduler.now + limit, lambda: end(None))
        self._put(QueuedItem("call", 0, self._stamps(), end))

    def mark(self, migration: int) -> None:
        """Send a marker behind all messages."""
        self._send(QueuedItem("marker", migration))

    def buffer(self) -> None:
        """Send no message until `switch`."""
        self.is_buffering = True

    def switch(self, spec: ConnectorSpec) -> None:
        """Send to a target from now on, first of all what was buffered."""
        self.spec, self.is_buffering = spec, False
        held, self._buffer = self._buffer, deque()
        for item in held:
            self._send(item)

    def close(self) -> None:
        """Let go of all routes."""
        for stream in self._routes.values():
            stream.close()
        self._routes.clear()

    def _stamps(self) -> Stamps:
        if not self.spec.carries:
            return ()
        key = self.spec.source, self.spec.source_epoch
        source = self._container.components.get(key)
        return source.ages.stamps(self.spec.carries) if source else ()

    def _put(self, item: QueuedItem) -> None:
        if not self.is_buffering:
            self._send(item)
        elif len(self._buffer) < MOST_BUFFERED:
            self._buffer.append(item)
        else:
            self.drops += 1

    def _send(self, item: QueuedItem) -> None:
        container, spec = self._container, self.spec
        world = container.world
        if spec.kind == "direct":
            container.take_item(spec, item)
            return
        here = container.process.computer.name
        there = spec.target_computer or here
        container.charge(spec)
        stream = self._routes.get(spec.key)
        if stream is None or stream.is_closed:
            stream = self._routes[spec.key] = world.network.stream(here, there)
        answer, size = item.answer, world.size_of(spec.name)

        def arrive() -> None:
            target = world.container_of(there, spec.target, spec.target_epoch)
            if target is not None:
                target.take_item(spec, item if answer is None else returning)

        if answer is not None:
            # request and answer together are as large as the profile says
            size /= 2
            returning = item._replace(
                answer=lambda stamps: world.send_back(there, here, size, answer, stamps)
            )
        stream.send(size, arrive)
