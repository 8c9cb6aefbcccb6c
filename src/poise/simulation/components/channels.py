"""The sending ends of connectors: a route to one target, and a buffer during a move."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Literal, NamedTuple

from poise.wire.records.deployment import ConnectorSpec

if TYPE_CHECKING:
    from poise.simulation.components.container import SimulatedContainer
    from poise.simulation.network.network import Stream

MOST_BUFFERED = 1000
_SIZE = 200


class QueuedItem(NamedTuple):
    """A message with its number, or the marker of a migration."""

    kind: Literal["message", "marker"]
    number: int


class SimulatedSender:
    """What a component sends over one slot, whichever target that leads to."""

    def __init__(self, container: SimulatedContainer, spec: ConnectorSpec) -> None:
        self.spec = spec
        self.is_buffering = False
        self.drops = 0
        self._container = container
        self._routes: dict[str, Stream] = {}
        self._buffer: deque[QueuedItem] = deque()

    def publish(self, number: int) -> None:
        """Send a message, or buffer it."""
        self._put(QueuedItem("message", number))

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

    def _put(self, item: QueuedItem) -> None:
        if not self.is_buffering:
            self._send(item)
        elif len(self._buffer) < MOST_BUFFERED:
            self._buffer.append(item)
        else:
            self.drops += 1

    def _send(self, item: QueuedItem) -> None:
        world, spec = self._container.world, self.spec
        here = self._container.process.computer.name
        stream = self._routes.get(spec.key)
        if stream is None or stream.is_closed:
            stream = world.network.stream(here, spec.target_computer or here)
            self._routes[spec.key] = stream

        def arrive() -> None:
            at = spec.target_computer or here
            target = world.container_of(at, spec.target, spec.target_epoch)
            if target is not None:
                target.take_item(spec, item)

        stream.send(_SIZE, arrive)
