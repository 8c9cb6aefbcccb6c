"""What an agent is asked by its manager, until it attends to it.

Requests come on zenoh's threads; the agent's own thread takes them out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import msgspec
import zenoh
from msgspec import Struct

from poise.wire.records.requests import PROTOCOL, Answer, ManagerRequest, Refused

_MOST = 100


class AgentInbox:
    """The requests that wait for an agent.

    Parameters
    ----------
    computer
        The agent's.
    wake
        Called on zenoh's threads when one came; must not block.
    """

    def __init__(self, computer: str, wake: Callable[[], None]) -> None:
        self._computer = computer
        self._wake = wake
        self._waiting: deque[tuple[ManagerRequest, zenoh.Query]] = deque()

    def hear(self, query: zenoh.Query) -> None:
        """Keep a request, or refuse it; for zenoh's threads."""
        data = query.payload.to_bytes() if query.payload is not None else b""
        try:
            # first, for what another protocol asks may look different
            spoken = msgspec.msgpack.decode(data, type=_Spoken).protocol
            if spoken != PROTOCOL:
                answer(query, self._refusal_of(spoken))
                return
            request = msgspec.msgpack.decode(data, type=ManagerRequest)
        except msgspec.DecodeError as error:
            answer(query, Refused(f"not a request: {error}"))
            return
        if len(self._waiting) >= _MOST:
            answer(query, Refused(f"over {_MOST} requests wait"))
            return
        self._waiting.append((request, query))
        self._wake()

    def take(self) -> Iterator[tuple[ManagerRequest, zenoh.Query]]:
        """Take out all that wait, in order; each is to be answered."""
        while self._waiting:
            yield self._waiting.popleft()

    def _refusal_of(self, protocol: int) -> Refused:
        return Refused(
            f"manager speaks protocol {protocol}, agent '{self._computer}' "
            f"speaks {PROTOCOL}: install the same Poise"
        )


class _Spoken(Struct, frozen=True):
    """The part that the requests of all protocols share."""

    protocol: int = PROTOCOL


def answer(query: zenoh.Query, said: Answer) -> None:
    """Answer a request, once."""
    query.reply(query.key_expr, msgspec.msgpack.encode(said))
    query.drop()  # type: ignore[no-untyped-call]
