"""What the manager asks of agents, and how long it waits for their answers."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Mapping
from queue import Empty
from typing import TypeVar

import msgspec
import zenoh
from zenoh.handlers import Callback

from poise.clock import Clock
from poise.decoding import from_msgpack
from poise.manage.agent_connections.reports import LOOK_EVERY, AgentReports, nothing
from poise.wire.codec import MALFORMED
from poise.wire.records.request_records import (
    Accepted,
    Answer,
    CheckpointCopy,
    ManagerRequest,
    Refused,
    Request,
)

K = TypeVar("K")

ANSWER_LIMIT = 2.0
"""An agent answers a claim or deployment within this time [s]."""
SEND_LIMIT = 2 * ANSWER_LIMIT
"""A claim that is not answered is sent again within this time [s]: to receive one twice
is harmless."""
_LAST_REPLY = 1.0
"""zenoh reports within this time after the steps' limit that no answer came [s]."""
LOSS_DELAY = 0.5
"""The loss of an agent is known this long [s] after its connection ends, at most."""
_LEAST_BANDWIDTH = 1e6
"""A state is sent at this rate at least [bytes/s]."""


def keep_limit(copy: CheckpointCopy) -> float:
    """Return how long an agent may take to keep a state [s]."""
    return ANSWER_LIMIT + len(copy.data or b"") / _LEAST_BANDWIDTH


def reason_of(answer: Answer) -> str:
    """Return why an agent did not do what it was asked."""
    return answer.reason if isinstance(answer, Refused) else str(answer)


def why_not_kept(copy: CheckpointCopy, answer: Answer | None) -> str:
    """Return why an agent did not keep a state within `keep_limit`; empty: it did."""
    if answer is None:
        return f"no answer within {keep_limit(copy):.0f} s"
    return "" if isinstance(answer, Accepted) else reason_of(answer)


class PendingAnswer:
    """The answer of an agent to one request, once it is there; any thread may look."""

    def __init__(self, token: int = 0) -> None:
        self.token = token
        self.answer: Answer | None = None  # nothing yet, or nothing at all
        self.is_done = False

    def set(self, answer: Answer | None) -> None:
        """Store what came first."""
        if not self.is_done:
            self.answer, self.is_done = answer, True


class AgentRequests:
    """Asks the agents of one robot, all at once."""

    def __init__(
        self,
        session: zenoh.Session,
        prefix: str,
        reports: AgentReports,
        clock: Clock,
        tokens: Mapping[str, int],
    ) -> None:
        self._session = session
        self._prefix = prefix
        self._reports = reports
        self._clock = clock
        self._tokens = tokens

    def begin(
        self, computer: str, request: Request, limit: float = ANSWER_LIMIT
    ) -> PendingAnswer:
        """Ask an agent and do not wait: news come when it has answered, or cannot."""
        reply = PendingAnswer(self._tokens.get(computer, 0))

        def take(received: zenoh.Reply | None = None) -> None:
            reply.set(_answer_of(received))
            self._reports.notify()

        self._get(computer, request, limit, take)
        return reply

    def send(self, computer: str, request: Request) -> Answer | None:
        """Return an agent's answer, within `SEND_LIMIT`; None: it gave none.

        An agent that is cut off for a moment gets its request again.
        """
        deadline = self._clock.now() + SEND_LIMIT
        while True:
            asked = {computer: (computer, request, ANSWER_LIMIT)}
            for _, answer in self.answers(asked):
                if answer is not None:
                    return answer
            self._clock.sleep(LOOK_EVERY)  # a loss may not be known yet
            left = max(0.0, deadline - self._clock.now())
            if not left or not self._reports.wait_news(
                lambda: computer in self._reports.reached(), left
            ):
                return None

    def answers(
        self,
        asked: Mapping[K, tuple[str, Request, float]],
        check: Callable[[], object] = nothing,
    ) -> Iterator[tuple[K, Answer | None]]:
        """Ask agents, all at once; yield each answer as it comes; None: there is none.

        `asked`: by any key: the computer, what its agent is asked, and the limit [s].
        """
        replies: queue.SimpleQueue[tuple[K, zenoh.Reply | None]] = queue.SimpleQueue()
        pending, deadline = set(asked), self._clock.now() + _LAST_REPLY
        deadline += max((limit for _, _, limit in asked.values()), default=0.0)
        for key, (computer, request, limit) in asked.items():

            def take(reply: zenoh.Reply | None = None, key: K = key) -> None:
                replies.put((key, reply))  # None: there is no other

            self._get(computer, request, limit, take)
        while pending:
            try:
                key, reply = replies.get(timeout=LOOK_EVERY)
            except Empty:
                check()
                away = self._reports.out_of_reach().keys()
                gone = [key for key in pending if asked[key][0] in away]
                if not gone and self._clock.now() < deadline:
                    continue
                # zenoh did not even report that the time is over
                key, reply = next(iter(gone or pending)), None
            if key in pending:
                pending.discard(key)
                yield key, _answer_of(reply)

    def _get(
        self, computer: str, request: Request, limit: float, take: Callable[..., object]
    ) -> None:
        token = self._tokens.get(computer, 0)
        self._session.get(
            f"{self._prefix}/agent/{computer}",
            Callback(take, take),
            payload=msgspec.msgpack.encode(
                ManagerRequest(token=token, request=request)
            ),
            timeout=limit,
        )

    def why_silent(self, computer: str, limit: float, patience: float) -> str:
        """Return what is known of an agent that gave no answer within `limit` [s].

        `patience`: zenoh reports the loss of an agent up to this time later [s].
        """
        if self._reports.wait_news(
            lambda: computer in self._reports.out_of_reach(), patience
        ):
            return "is out of reach"
        return f"did not answer within {limit:g} s"


def _answer_of(reply: zenoh.Reply | None) -> Answer | None:
    """Return an agent's answer: None when it gave none, `Refused` when it is none."""
    if reply is None or reply.ok is None:
        return None
    try:
        answer: Answer = from_msgpack(reply.ok.payload.to_bytes(), Answer)
    except MALFORMED as error:
        return Refused(f"not an answer: {error}")
    return answer
