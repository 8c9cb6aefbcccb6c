"""What other threads leave to an agent's own, above all its manager's requests."""

from __future__ import annotations

import logging
import traceback
from collections import deque
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import TypeVar

import msgspec
import zenoh
from msgspec import structs

from poise.clock import Clock
from poise.decoding import from_msgpack
from poise.runtime.agent.surroundings import Reply
from poise.threads import SHOWN_FOR, BackOff
from poise.version import VERSION
from poise.wire.codec import MALFORMED
from poise.wire.records.request_records import (
    LEAST_PROTOCOL,
    PROTOCOL,
    Answer,
    ManagerRequest,
    Refused,
    Versioned,
)
from poise.wire.records.status_records import ErrorCount

log = logging.getLogger(__name__)

_MOST_TROUBLES = 20
"""The most parts whose errors are shown; all errors are logged."""

T = TypeVar("T")


class SupervisedParts:
    """Runs the parts of an agent's work."""

    def __init__(self, clock: Clock, wall: Callable[[], float]) -> None:
        self._clock = clock
        self._wall = wall
        self._rests: dict[str, BackOff] = {}
        self._errors: dict[str, tuple[float, ErrorCount]] = {}
        self._lock = Lock()  # threads report, too

    def run(self, part: str, work: Callable[..., T], *args: object) -> T | None:
        """Do a part of the work, unless it rests after an error."""
        if self._rests and self.is_resting(part):
            return None
        return self.attempt(part, work, *args)

    def attempt(self, part: str, work: Callable[..., T], *args: object) -> T | None:
        """Do what comes once; return None if it fails."""
        try:
            return work(*args)
        except Exception as error:  # noqa: BLE001, it is logged, shown and counted
            self.report(part, error)
            return None

    def report(self, part: str, error: BaseException) -> None:
        """Log and show an error, and let its part rest; from any thread."""
        text = "".join(traceback.format_exception(error))
        log.error(
            "%s: an error of Poise; all other parts continue\n%s", part, text.rstrip()
        )
        now = self._clock.now()
        with self._lock:
            self._rests.setdefault(part, BackOff()).note_end(now)
            _, known = self._errors.pop(part, (0.0, None))
            known = known or ErrorCount(
                where=part, text=text, first=self._wall(), count=0
            )
            known = structs.replace(known, text=text, count=known.count + 1)
            self._errors[part] = now, known
            while len(self._errors) > _MOST_TROUBLES:
                del self._errors[next(iter(self._errors))]

    def is_resting(self, part: str) -> bool:
        """Return whether a part waits after an error."""
        rest = self._rests.get(part)
        return rest is not None and self._clock.now() < rest.again_at

    def again_at(self, part: str) -> float:
        """Return when a part may be done again [s]."""
        rest = self._rests.get(part)
        return float("-inf") if rest is None else rest.again_at

    def errors(self) -> tuple[ErrorCount, ...]:
        """Return the errors of the last `SHOWN_FOR`, the latest of each part."""
        since = self._clock.now() - SHOWN_FOR
        with self._lock:
            return tuple(error for at, error in self._errors.values() if at >= since)


_MOST = 100


class AgentInbox:
    """What waits for an agent's thread, which does it in order."""

    def __init__(
        self,
        computer: str,
        attend: Callable[[ManagerRequest, Reply], None],
        wake: Callable[[], None],
        supervised: SupervisedParts,
    ) -> None:
        self._computer = computer
        self._attend = attend
        self._wake = wake
        self._supervised = supervised
        self._waiting: deque[Callable[[], None]] = deque()

    def put(self, work: Callable[[], None]) -> None:
        """Leave something to the agent's thread; from any thread."""
        self._waiting.append(work)
        self._wake()

    def hear(self, query: zenoh.Query) -> None:
        """Keep a request, or refuse it; for zenoh's threads."""
        data = query.payload.to_bytes() if query.payload is not None else b""
        try:
            # first, for what another protocol asks may look different
            asker = from_msgpack(data, Versioned)
            if not asker.is_understood:
                answer(query, Refused(self._not_understood(asker)))
                return
            request = from_msgpack(data, ManagerRequest)
        except MALFORMED as error:
            answer(query, Refused(f"not a request: {error}"))
            return
        if len(self._waiting) >= _MOST:
            answer(query, Refused(f"over {_MOST} requests wait"))
            return
        self.put(partial(self._attend, request, partial(answer, query)))

    def _not_understood(self, asker: Versioned) -> str:
        older = "agent" if asker.protocol > PROTOCOL else "manager"
        return (
            f"manager speaks protocol {asker.least} to {asker.protocol}, agent "
            f"'{self._computer}' (Poise {VERSION}) speaks {LEAST_PROTOCOL} to "
            f"{PROTOCOL}: upgrade the {older}, one release after the other"
        )

    def work(self) -> None:
        """Do all that waits."""
        while self._waiting:
            self._supervised.attempt("requests", self._waiting.popleft())


def answer(query: zenoh.Query, reply: Answer) -> None:
    """Answer a request, once."""
    query.reply(query.key_expr, msgspec.msgpack.encode(reply))
    query.drop()  # type: ignore[no-untyped-call]
