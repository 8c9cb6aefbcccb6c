"""Pipes between containers of different computers, over zenoh.

Every container that needs one opens a session as a peer. It finds the others by gossip
through all agents and links to them directly, so that no call takes a detour.

zenoh's own threads only put what comes into rings, one for the calls and one for the
messages of each connector, and threads of ours work on it. So no handler, however slow
and whatever it waits for, keeps zenoh from bringing answers or other messages.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import logging
import re
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from poise.errors import RunError, Timeout, Unavailable
from poise.wire import frame
from poise.wire.codec import WireError
from poise.wire.frame import Frame
from poise.wire.pipe import (
    LAST_LIMIT,
    MOST_UNREAD,
    Closed,
    Handler,
    Pieces,
    Refused,
    ignore,
)
from poise.wire.underway import UnderWay
from poise.wire.workers import Workers

log = logging.getLogger(__name__)

_CALLERS = 8
"""Calls that are worked on at a time, per connector: they are of one chain, unless the
caller gave up some."""
_WAITING = 64
"""Calls that may wait, per connector; of more, the oldest are given up."""

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""What `mallopt` calls them."""


def open_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    gossip: bool = True,
    lease: float = 10.0,
) -> zenoh.Session:
    """Open a zenoh session as a peer that knows nobody but whom it is told.

    Parameters
    ----------
    listen, connect
        zenoh endpoints, such as ``tcp/10.0.0.2:7447``.
    gossip
        Whether it also links to the peers that its peers know.
    lease
        After this time without a sign of life a link counts as lost [s].

    Raises
    ------
    RunError
        An address cannot be listened on: it is not this computer's, or in use.
    """
    settings = {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        # never give up: a peer that restarts is found again
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {
            "period_init_ms": 50,
            "period_max_ms": 500,
            "period_increase_factor": 2,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": gossip,
        # with more, every new peer makes all tell all others of it (measured with 11
        # peers: 10 ms of CPU on each instead of 2)
        "scouting/gossip/multihop": False,
        "scouting/gossip/autoconnect_strategy": {
            "peer": {"to_router": "always", "to_peer": "greater-zid"}
        },
        "open/return_conditions/connect_scouted": False,
        "transport/link/tx/lease": int(lease * 1000),
        # shared memory would pass through network namespaces, and between containers
        # of one computer Poise has better
        "transport/shared_memory/enabled": False,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        # zenoh tells where in its sources; what the system said is enough
        said = re.search(r"[^:\[]+\(os error \d+\)", str(error))
        why = said.group().strip() if said else str(error)
        raise RunError(f"cannot listen on {', '.join(listen)}: {why}") from None


def keep_memory() -> None:
    """Let this process keep memory that was freed for the next large message.

    The GNU C library gives blocks of 128 KB and more back to the kernel at once, and
    every page of the next one is cleared and mapped anew: with six copies of a message
    on its way there and back that took longer than all the rest. Up to 64 MiB stay with
    the process now. Other C libraries are left as they are.
    """
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, 32 << 20)
        library.mallopt(_TRIM_THRESHOLD, 64 << 20)


class RemotePipe:
    """The sending end of a connector; only for messages without `calls`."""

    def __init__(
        self, session: zenoh.Session, key: str, limit: float, *, calls: bool = True
    ) -> None:
        self._key = key
        self._changed = threading.Lock()
        self._num_calls = 0
        self._is_closed = False
        self._querier: zenoh.Querier | None = None
        if calls:
            self._querier = session.declare_querier(
                f"{key}/call", timeout=limit, express=True
            )
        self._publisher = session.declare_publisher(
            f"{key}/message",
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
        )

    def is_ready(self) -> bool:
        """Return whether the receiving end was declared and its computer is linked."""
        querier = self._querier
        return (querier is None or _matches(querier)) and _matches(self._publisher)

    def request(self, pieces: Pieces, limit: float) -> Frame:
        """Send a call and wait for its answer (`poise.wire.pipe.Pipe.request`)."""
        with self._changed:
            if self._is_closed:
                raise Closed(f"{self._key} is closed")
            self._num_calls += 1
        try:
            return self._request(pieces, limit)
        finally:
            with self._changed:
                self._num_calls -= 1
                self._undeclare_if_done()

    def _request(self, pieces: Pieces, limit: float) -> Frame:
        if self._querier is None:
            raise Unavailable(f"{self._key} is for messages only")
        started = time.monotonic()
        for reply in self._querier.get(payload=b"".join(pieces)):
            if reply.ok is not None:
                return frame.parse(reply.ok.payload.to_bytes())
            break
        if time.monotonic() - started < limit:
            # zenoh ends a query at once when nobody is there, and without a reply
            # when the server dies under it
            raise Unavailable(f"nobody answers at {self._key}/call")
        raise Timeout(f"{self._key}/call: no answer within {limit} s")

    def push(self, pieces: Pieces, limit: float) -> None:  # noqa: ARG002, zenoh's own
        """Send a message; blocks while the link is full, as long as zenoh allows."""
        # asking costs 0.7 us, and a message to nobody would vanish unseen
        if not _matches(self._publisher):
            raise Unavailable(f"nobody listens at {self._key}/message")
        self._publisher.put(b"".join(pieces))

    def close(self) -> None:
        """Send no more; calls under way still get their answers."""
        with self._changed:
            if not self._is_closed:
                self._is_closed = True
                self._undeclare_if_done()

    def _undeclare_if_done(self) -> None:
        # zenoh drops the answers to a querier that is undeclared
        if self._is_closed and not self._num_calls:
            _undeclare(*filter(None, (self._querier, self._publisher)))


class RemoteServer:
    """The receiving ends of a container."""

    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self._session = session
        self._prefix = prefix
        self._declared: dict[str, list[Any]] = {}
        self._under_way: dict[str, UnderWay] = {}

    def open(
        self,
        connector: str,
        handler: Handler,
        refused: Refused = ignore,
        most: int = MOST_UNREAD,
        *,
        calls: bool = True,
    ) -> None:
        """Receive the frames of `connector` from now on; only messages without `calls`.

        What waits for a ring wakes ten times a second, to look for signals.
        """
        handle = partial(_handle, connector, handler, refused)
        key = f"{self._prefix}/{connector}"
        under_way = self._under_way[connector] = UnderWay()
        declared = self._declared[connector] = list[Any]()
        if calls:
            # a call that falls out of its ring is Unavailable to its caller
            waiting: RingChannel[zenoh.Query] = RingChannel(_WAITING)
            queries = self._session.declare_queryable(f"{key}/call", waiting)
            answer = partial(_answer, connector, handle, under_way)
            Workers(iter(queries), answer, _CALLERS)
            declared.append(queries)
        samples = self._session.declare_subscriber(f"{key}/message", RingChannel(most))
        threading.Thread(
            target=_hear, args=(samples, handle), name="messages", daemon=True
        ).start()
        declared.append(samples)

    def shut(self, connector: str) -> None:
        """Receive no more of them, and answer those that came."""
        if connector in self._declared:
            _undeclare(*self._declared.pop(connector))
            if not self._under_way.pop(connector).wait_none(LAST_LIMIT):
                log.warning("connector %s: calls are given up", connector)

    def close(self) -> None:
        """Shut all."""
        for connector in list(self._declared):
            self.shut(connector)


def _hear(samples: Iterable[zenoh.Sample], handle: Callable[[bytes], object]) -> None:
    for sample in samples:
        handle(sample.payload.to_bytes())


def _answer(
    connector: str,
    handle: Callable[[bytes], Pieces | None],
    calls: UnderWay,
    query: zenoh.Query,
) -> None:
    calls.begin()
    data = query.payload.to_bytes() if query.payload is not None else b""
    answer = handle(data)
    try:
        if answer is not None:
            query.reply(query.key_expr, b"".join(answer))
    except zenoh.ZError as error:
        log.warning("connector %s: the caller is gone: %s", connector, error)
    finally:
        query.drop()  # type: ignore[no-untyped-call]
        calls.end()


def _handle(
    connector: str, handler: Handler, refused: Refused, data: bytes
) -> Pieces | None:
    try:
        return handler(frame.parse(data))
    except WireError as error:
        refused(error)
        log.warning("connector %s: refused: %s", connector, error)
        return frame.failure("WireError", str(error))


def _matches(entity: zenoh.Querier | zenoh.Publisher) -> bool:
    # the stub says bool, the library returns a record
    return bool(getattr(entity.matching_status, "matching", False))


def _undeclare(*entities: Any) -> None:  # noqa: ANN401, any declared zenoh entity
    for entity in entities:
        entity.undeclare()
