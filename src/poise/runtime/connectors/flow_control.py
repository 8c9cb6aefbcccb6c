"""Back-pressure between containers: a source sends only what its target has room for.

A target whose queue blocks sends *credit*: how many messages the source may have sent
in all. The number is a total, so credit that is lost, doubled or late does no harm: the
next one says all. A source without credit *requests* it, again and again, in the stream
of its messages: what it sent before has arrived by then, or never will. Both numbers
count from the first message over one route. The route has a random number of its own:
a restarted source or target, and one that moves, begins with another.

A target sends credit when half of its queue was emptied since the last time: one frame
for many messages, sent by the container's I/O thread. A queue that keeps the last
messages gives credit without bound, once.
"""

from __future__ import annotations

import logging
import secrets
import threading
from collections.abc import Callable
from weakref import WeakValueDictionary

from poise.errors import CallError
from poise.runtime.execution.connector_counters import Counts
from poise.runtime.execution.mailbox import Feed
from poise.wire import frame
from poise.wire.codec import Codec, codec
from poise.wire.connections.channel import Channel, Pieces
from poise.wire.frame import Frame, Kind

log = logging.getLogger(__name__)

CREDITS = "credits"
"""The connector over which a container receives the credit of all its routes."""
_UNBOUNDED = 1 << 62
_AT_FIRST = 1
"""Every queue has room for one: the first message need not wait for credit."""
_UNHEARD, _HEARD = 0, 1
"""The tag of a request: whether the source ever received credit for this route."""
_LIMIT = 0.2
"""Sending credit takes no longer than this [s]: others wait behind it."""
_NOTHING: Codec[None] = Codec(type(None))
_ADDRESS = codec(str)


class Credit:
    """How much a source may send over one route.

    Parameters
    ----------
    address
        Where its container receives credit.
    """

    def __init__(self, address: str) -> None:
        self.route = secrets.randbits(63) | 1
        self.sent = 0
        self.on_credit: Callable[[], None] = _do_nothing
        self._address = address
        self._total = _AT_FIRST

    def has_room(self) -> bool:
        """Return whether one more message may go."""
        return self.sent < self._total

    def request(self) -> Pieces:
        """Return the frame that requests credit."""
        return frame.segments(
            _ADDRESS,
            self._address,
            Kind.CREDIT_REQUEST,
            tag=_HEARD if self._total > _AT_FIRST else _UNHEARD,
            number=self.sent,
            chain=self.route,
        )

    def extend(self, total: int) -> None:
        """Take credit; a total that is less than an earlier one came late."""
        if total > self._total:
            self._total = total
            self.on_credit()


class Credits:
    """The credits of all routes that begin in a container."""

    def __init__(self) -> None:
        self._by_route: WeakValueDictionary[int, Credit] = WeakValueDictionary()

    def open(self, address: str) -> Credit:
        """Return the credit of a new route."""
        credit = Credit(address)
        self._by_route[credit.route] = credit
        return credit

    def handle(self, received: Frame) -> None:
        """Take a frame with credit; one for a route that is gone changes nothing."""
        credit = self._by_route.get(received.chain)
        if credit is not None and received.kind is Kind.CREDIT:
            credit.extend(received.number)


class CreditIssuer:
    """The target's side of one connector: counts what came, and gives credit.

    Parameters
    ----------
    connector
        Its name.
    feed
        The connector's way into the port's queue.
    counts
        Where messages that were lost on their way are counted.
    open_channel
        Returns a channel to the container with this address; WireError when it is none.
    post
        Runs a task on the container's I/O thread.
    """

    def __init__(
        self,
        connector: str,
        feed: Feed,
        counts: Counts,
        open_channel: Callable[[str], Channel],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        self._connector = connector
        self._feed = feed
        self._counts = counts
        self._open_channel = open_channel
        self._post = post
        self._lock = threading.Lock()
        self._route = 0
        self._before = 0
        self._came = 0
        self._issued = 0
        self._is_posted = False
        self._address = ""
        self._channel: Channel | None = None
        feed.on_room = self._on_room

    def came(self, received: Frame) -> None:
        """Count a message, which is the source's `received.number`-th."""
        with self._lock:
            self._count(received.chain, received.number - 1)
            self._came = received.number

    def requested(self, received: Frame) -> None:
        """Give credit to a source that has sent `received.number` messages.

        Raises
        ------
        WireError
            It does not say where it is.
        """
        address = received.value(_ADDRESS)
        with self._lock:
            self._count(received.chain, received.number)
            # else they came to this target before its container was restarted
            if received.tag == _UNHEARD:
                self._count_lost(self._before)
            self._before = 0
            if address != self._address or self._channel is None:
                self._close_channel()
                self._channel = self._open_channel(address)
                self._address = address
            self._issue(self._may_have_sent())

    def close(self) -> None:
        """Give no more credit."""
        self._feed.on_room = _do_nothing
        with self._lock:
            self._close_channel()

    def _count(self, route: int, came: int) -> None:
        """Note how many messages came, and count those that got lost."""
        if route != self._route:
            self._route = route
            self._issued = 0
            self._before = came
        else:
            self._count_lost(came - self._came)
        self._came = came

    def _count_lost(self, lost: int) -> None:
        if lost > 0:
            self._counts.drops += lost
            text = "connector %s: %d messages were lost on their way"
            log.warning(text, self._connector, lost)

    def _may_have_sent(self) -> int:
        room = self._feed.room()
        return _UNBOUNDED if room is None else self._came + room

    def _on_room(self) -> None:
        """Give credit when half of the queue was emptied since the last time."""
        with self._lock:
            total = self._may_have_sent()
            if self._channel and total - self._issued >= self._feed.half:
                self._issue(total)

    def _issue(self, total: int) -> None:
        self._issued = total
        if not self._is_posted:
            self._is_posted = True
            self._post(self._send)

    def _send(self) -> None:
        with self._lock:
            self._is_posted = False
            channel, route, total = self._channel, self._route, self._issued
        if channel is None:
            return
        pieces = frame.segments(_NOTHING, None, Kind.CREDIT, number=total, chain=route)
        try:
            channel.push(pieces, _LIMIT)
        except CallError as error:
            log.debug("credit was not sent, the source will request it: %s", error)
            return
        if total == _UNBOUNDED:
            with self._lock:
                if self._channel is channel:
                    self._close_channel()

    def _close_channel(self) -> None:
        if self._channel is not None:
            self._channel.close()
            self._channel = None


def _do_nothing() -> None:
    pass
