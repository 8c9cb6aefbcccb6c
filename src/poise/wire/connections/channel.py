"""Channels carry connectors between containers; handlers take what they bring."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from poise.errors import Unavailable
from poise.wire.codec import Bytes, WireError
from poise.wire.frame import Frame

Pieces = list[Bytes]


class Closed(Unavailable):
    """The channel was closed here before anything was sent."""


Handler = Callable[[Frame], Pieces | None]
"""Takes a frame and returns the pieces of an answer, or None.

It may block, and must not raise. Messages of one channel come one after the other, in
order.
"""


Refused = Callable[[WireError], None]
"""Takes the error of a malformed frame; must not block or raise."""


def ignore(_: WireError) -> None:
    """Ignore it."""


class Channel(Protocol):
    """The sending end of a connector between containers. Any thread may use it."""

    def is_ready(self) -> bool:
        """Return at once whether the receiving end is there."""
        ...

    def request(self, pieces: Pieces, limit: float) -> Frame:
        """Send a call and return the answer.

        Raises
        ------
        Closed
            This end was closed; nothing was sent.
        Unavailable
            Nobody is there, or it went away.
        Timeout
            No answer within `limit` [s].
        """
        ...

    def push(self, pieces: Pieces, limit: float) -> None:
        """Send a message; may block up to `limit` [s] when the receiver is slow.

        Raises
        ------
        Unavailable, Timeout
            As for `request`.
        """
        ...

    def close(self) -> None:
        """Send no more, and return at once; calls under way go on."""
        ...
