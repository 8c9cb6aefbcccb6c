"""Back-pressure between containers: a source sends only what its target has room for.

A target whose queue blocks *grants*: it tells the source how many messages that may
have sent in all. The number is a total and no difference, so a grant that is lost,
comes twice or too late does no harm: the next one says all. A source that has nothing
left *asks*, again and again, in the stream of its messages: what it sent before has
arrived by then, or never will. Both numbers count from the first message over one path,
and the path has a random number of its own, its *life*: whoever is started anew, or
moves, begins with other ones.

A target grants when half of its queue was emptied since it last did: one frame for many
messages. A queue that keeps the last messages grants without end, once.
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

CREDITS = "grants"
"""What the pipe is called over which a container hears all of its issuer."""
_UNBOUNDED = 1 << 62
_AT_FIRST = 1
"""Every queue has room for one: the first message need not wait for a grant."""
_UNHEARD, _HEARD = 0, 1
"""The tag of a question: whether the source ever heard of a grant for this path."""
_LIMIT = 0.2
"""Whoever grants waits no longer than this for the way to the source [s]."""
_NOTHING: Codec[None] = Codec(type(None))
_ADDRESS = codec(str)


class Credit:
    """How much a source may send over one path.

    Parameters
    ----------
    address
        Where its container hears of issuer.
    """

    def __init__(self, address: str) -> None:
        self.life = secrets.randbits(63) | 1
        self.sent = 0
        self.on_credit: Callable[[], None] = _do_nothing
        self._address = address
        self._granted = _AT_FIRST

    def has_room(self) -> bool:
        """Return whether one more message may go."""
        return self.sent < self._granted

    def question(self) -> Pieces:
        """Return the frame that asks for a grant."""
        return frame.segments(
            _ADDRESS,
            self._address,
            Kind.CREDIT_REQUEST,
            tag=_HEARD if self._granted > _AT_FIRST else _UNHEARD,
            number=self.sent,
            chain=self.life,
        )

    def hear(self, granted: int) -> None:
        """Take a grant; one that says less than an earlier one came late."""
        if granted > self._granted:
            self._granted = granted
            self.on_credit()


class Credits:
    """The credits of all paths that begin in a container."""

    def __init__(self) -> None:
        self._by_life: WeakValueDictionary[int, Credit] = WeakValueDictionary()

    def open(self, address: str) -> Credit:
        """Return the credit of a new path."""
        credit = Credit(address)
        self._by_life[credit.life] = credit
        return credit

    def handle(self, received: Frame) -> None:
        """Take a frame with a grant; one for a path that is gone says nothing."""
        credit = self._by_life.get(received.chain)
        if credit is not None and received.kind is Kind.CREDIT:
            credit.hear(received.number)


class CreditIssuer:
    """The target's side of one connector: counts what came, and grants more.

    Parameters
    ----------
    connector
        Its name.
    feed
        The connector's way into the port's queue.
    counts
        Learn of messages that were lost on their way.
    open_pipe
        Returns a pipe to the container with this address; WireError when it is none.
    """

    def __init__(
        self,
        connector: str,
        feed: Feed,
        counts: Counts,
        open_pipe: Callable[[str], Channel],
    ) -> None:
        self._connector = connector
        self._feed = feed
        self._counts = counts
        self._open_pipe = open_pipe
        self._lock = threading.Lock()
        self._life = 0
        self._before = 0
        self._came = 0
        self._told = 0
        self._address = ""
        self._channel: Channel | None = None
        feed.on_room = self._taken

    def came(self, received: Frame) -> None:
        """Take note of a message, which is the source's `received.number`-th."""
        with self._lock:
            self._note(received.chain, received.number - 1)
            self._came = received.number

    def asked(self, received: Frame) -> None:
        """Answer a source that has sent `received.number` messages.

        Raises
        ------
        WireError
            It does not say where it is.
        """
        address = received.value(_ADDRESS)
        with self._lock:
            self._note(received.chain, received.number)
            # else they came to this target before its container was started anew
            if received.tag == _UNHEARD:
                self._count_lost(self._before)
            self._before = 0
            if address != self._address or self._channel is None:
                self._close_pipe()
                self._channel = self._open_pipe(address)
                self._address = address
            self._told = self._may_have_sent()
        self._tell()

    def close(self) -> None:
        """Grant no more."""
        self._feed.on_room = _do_nothing
        with self._lock:
            self._close_pipe()

    def _note(self, life: int, came: int) -> None:
        """Take note that so many messages came, and tell and count what got lost."""
        if life != self._life:
            self._life = life
            self._told = 0
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

    def _taken(self) -> None:
        """Grant again when half of the queue was emptied since the last time."""
        with self._lock:
            granted = self._may_have_sent()
            if not self._channel or granted - self._told < self._feed.half:
                return
            self._told = granted
        self._tell()

    def _tell(self) -> None:
        with self._lock:
            channel, life, told = self._channel, self._life, self._told
        if channel is None:
            return
        pieces = frame.segments(_NOTHING, None, Kind.CREDIT, number=told, chain=life)
        try:
            channel.push(pieces, _LIMIT)
        except CallError as error:
            log.debug("a grant did not go out, the source will ask: %s", error)
            return
        if told == _UNBOUNDED:
            with self._lock:
                self._close_pipe()

    def _close_pipe(self) -> None:
        if self._channel is not None:
            self._channel.close()
            self._channel = None


def _do_nothing() -> None:
    pass
