"""The seam between a sender and the ways to its target."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from poise.runtime.connectors.interface import Method

if TYPE_CHECKING:
    from poise.runtime.connectors.sender import Sender


class Route(Protocol):
    """A way to one incarnation of the target."""

    def is_ready(self) -> bool:
        """Return at once whether the other end is there."""
        ...

    def function(self, method: Method, sender: Sender) -> Callable[..., Any]:
        """Return the function that calls a method of the target."""
        ...

    def is_calling(self) -> bool:
        """Return at once whether a call waits for an answer from another container."""
        ...

    def push(self, method: Method | None, value: object) -> int:
        """Send a message, or a one-way call of `method`; return its size [bytes]."""
        ...

    def has_room(self) -> bool:
        """Return at once whether the target has room for one more message."""
        ...

    def ask(self) -> None:
        """Ask for room, in case that a credit got lost; raises as `push`."""
        ...

    def send_marker(self, number: int) -> None:
        """Send a marker behind all that was pushed; raises as `push`."""
        ...

    def give_up(self) -> None:
        """Wait no more for a computer that is cut off, also in a `push` under way."""
        ...

    def close(self) -> None:
        """Release its resources at once; harmless when repeated."""
        ...
