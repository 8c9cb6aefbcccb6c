"""Asks other computers for the time, to know how far their clocks are ahead.

Once a second an agent asks all others at once, over the links that it has anyway, and
answers them when they ask. zenoh's own threads read the clock as a question or an
answer comes: what the agent does meanwhile does not make the trips longer.
"""

from __future__ import annotations

import logging
import threading

import msgspec
import zenoh

from poise.clock import Clock
from poise.runtime.agent.clock_offset import ClockOffset, RoundTrip
from poise.wire.records.clocks import ClockAnswer, ClockStatus

log = logging.getLogger(__name__)

EVERY = 1.0
"""Others are asked so often [s]."""
_EVERY_AT_FIRST = 0.1
_AT_FIRST = 10
"""So many times at the beginning it asks more often: the quickest trip counts."""
_ANSWER_LIMIT = 1.0


class ClockSynchronisation:
    """A thread of the agent.

    Parameters
    ----------
    session
        zenoh's; it may be used until `stop`.
    prefix
        What all keys of the robot begin with.
    computer
        Its own name.
    """

    def __init__(
        self,
        session: zenoh.Session,
        prefix: str,
        computer: str,
        clock: Clock,
    ) -> None:
        self._session = session
        self._prefix = prefix
        self._computer = computer
        self._clock = clock
        self._offsets: dict[str, ClockOffset] = {}
        self._known: dict[str, ClockStatus] = {}
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._decoder = msgspec.msgpack.Decoder(ClockAnswer)
        self._thread = threading.Thread(target=self._main, name="clocks", daemon=True)
        self._key = f"{prefix}/clock/{computer}"
        self._answers = session.declare_queryable(self._key, self._answer)

    def start(self) -> None:
        """Begin to ask."""
        self._thread.start()

    def stop(self) -> None:
        """Ask and answer no more."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(_ANSWER_LIMIT)
        self._answers.undeclare()  # type: ignore[no-untyped-call]

    def known(self) -> dict[str, ClockStatus]:
        """Return what was known of every other computer's clock last, by name."""
        return self._known

    def _now_known(self) -> dict[str, ClockStatus]:
        with self._lock:
            now = self._clock.now()
            found = {name: offset.at(now) for name, offset in self._offsets.items()}
        return {name: clock for name, clock in sorted(found.items()) if clock}

    def _main(self) -> None:
        asked = answered = 0
        while not self._ended.wait(self._pause(answered or asked)):
            asked += 1
            try:
                self._ask()
                self._known = self._now_known()
            except Exception:  # the next round may work again
                log.exception("clocks cannot be compared")
            answered += bool(self._offsets)

    @staticmethod
    def _pause(rounds: int) -> float:
        """Return how long to wait [s]; who is alone soon asks seldom."""
        return EVERY if rounds >= _AT_FIRST else _EVERY_AT_FIRST

    def _ask(self) -> None:
        sent = self._clock.now()
        self._session.get(
            f"{self._prefix}/clock/*",
            lambda reply: self._hear(sent, self._clock.now(), reply),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,  # answers come on at once
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
            allowed_destination=zenoh.Locality.REMOTE,
            timeout=_ANSWER_LIMIT,
        )

    def _answer(self, query: zenoh.Query) -> None:
        received = self._clock.now()
        answer = ClockAnswer(self._computer, received, self._clock.now())
        query.reply(self._key, msgspec.msgpack.encode(answer), express=True)
        query.drop()  # type: ignore[no-untyped-call]

    def _hear(self, sent: float, returned: float, reply: zenoh.Reply) -> None:
        if reply.ok is None:
            return
        try:
            answer = self._decoder.decode(reply.ok.payload.to_bytes())
        except msgspec.DecodeError as error:
            log.warning("a clock's answer is none: %s", error)
            return
        trip = RoundTrip(sent, answer.received, answer.answered, returned)
        with self._lock:
            self._offsets.setdefault(answer.computer, ClockOffset()).add(trip)
