"""Back-pressure between containers: a source sends only what its target has room for.

A target whose queue blocks sends *credit*: how many messages the source may have sent
in all, since the route began (its number is random, so a restarted end differs). As
a total it may be lost, doubled or late. A source without credit *requests* it in the
stream of its messages: what it sent before has arrived by then, or never will. Each
connection begins with a request, so that lost messages are counted at once. Credit goes
back once half of the queue is empty: one frame for many messages. A queue that keeps
the last messages gives it without bound. It also says which numbered message came last
(`latest`).
"""

from __future__ import annotations

import logging
import secrets
import threading
from collections.abc import Callable, Mapping

from poise.runtime.connectors.latest import HEARD, NONE, Number
from poise.runtime.execution.mailbox import Feed
from poise.wire import frame
from poise.wire.codec import Codec, WireError
from poise.wire.connections.connection import Connection
from poise.wire.frame import Frame, FrameKind, Pieces

log = logging.getLogger(__name__)

_UNBOUNDED = 1 << 62
_MOST_SENT = 1 << 48
"""More messages go over no route: one a microsecond would take nine years."""
_AT_FIRST = 1
"""Every queue has room for one: the first message need not wait for credit."""
_UNHEARD, _HEARD = 0, 1
"""The tag of a request: whether the source ever received credit for this route."""
_NOTHING: Codec[None] = Codec(type(None))


class Credit:
    """How much a source may send over one route."""

    def __init__(self) -> None:
        self.route = secrets.randbits(63) | 1
        self.sent = 0
        self.on_credit: Callable[[], None] = lambda: None
        self.on_heard: Callable[[Number], None] | None = None
        self._total = _AT_FIRST
        self._asked_at = 0

    def has_room(self) -> bool:
        """Return whether one more message may go."""
        return self.sent < self._total

    def note_sent(self) -> None:
        """Count a message that went out."""
        self.sent += 1

    def request(self) -> Pieces:
        """Return the frame that requests credit."""
        self._asked_at = self.sent
        return frame.segments(
            _NOTHING,
            None,
            FrameKind.CREDIT_REQUEST,
            tag=_HEARD if self._total > _AT_FIRST else _UNHEARD,
            number=self.sent,
            chain=self.route,
        )

    def note_credit(self, received: Frame) -> bool:
        """Take a frame with credit, unless it is late; return whether more may come."""
        is_ours = received.kind is FrameKind.CREDIT and received.chain == self.route
        if is_ours and received.number > self._total:
            self._total = received.number
            self.on_credit()
        if self.on_heard is None:
            return self._total < _UNBOUNDED
        # what went out since the request is later than what the target speaks of
        if is_ours and self.sent == self._asked_at:
            self.on_heard(received.value(HEARD) or NONE)
        return True


class CreditIssuer:
    """The target's side of one connector: counts what came, and gives credit."""

    def __init__(self, connector: str, feed: Feed, heard: Mapping[str, Number]) -> None:
        self._connector = connector
        self._heard = heard
        self._feed = feed
        self._lock = threading.Lock()
        self._route = 0
        self._before = 0
        self._came = 0
        self._issued = 0
        self._back: Connection | None = None
        feed.on_room = self._on_room

    def came(self, received: Frame) -> None:
        """Count a message, which is the source's `received.number`-th."""
        with self._lock:
            self._count(received.chain, received.number - 1)
            self._came = received.number

    def requested(self, received: Frame, back: Connection | None) -> None:
        """Give credit to a source that has sent `received.number` messages."""
        with self._lock:
            self._count(received.chain, received.number)
            # else they came to this target before its container was restarted
            if received.tag == _UNHEARD:
                self._count_lost(self._before)
            self._before = 0
            self._back = back
            self._issue(self._may_have_sent())

    def close(self) -> None:
        """Give no more credit."""
        self._feed.on_room = lambda: None
        with self._lock:
            self._back = None

    def _count(self, route: int, came: int) -> None:
        """Count a route's messages that got lost; WireError: over `_MOST_SENT` went."""
        if came > _MOST_SENT:
            raise WireError(f"{came} messages are said to have gone over one route")
        if route != self._route:
            self._route = route
            self._issued = 0
            self._before = came
        else:
            self._count_lost(came - self._came)
        self._came = came

    def _count_lost(self, lost: int) -> None:
        if lost > 0:
            self._feed.counts.drops += lost
            text = "connector %s: %d messages were lost on their way"
            log.warning(text, self._connector, lost)

    def _may_have_sent(self) -> int:
        room = self._feed.room()
        return _UNBOUNDED if room is None else self._came + room

    def _on_room(self) -> None:
        """Give credit when half of the queue was emptied since the last time."""
        with self._lock:
            total = self._may_have_sent()
            if total - self._issued >= self._feed.half:
                self._issue(total)

    def _issue(self, total: int) -> None:
        if self._back is None:
            return
        self._issued = total
        pieces = frame.segments(
            HEARD,
            self._heard.get(self._connector),
            FrameKind.CREDIT,
            number=total,
            chain=self._route,
        )
        if not self._back.send_back(pieces) or total == _UNBOUNDED:
            self._back = None
