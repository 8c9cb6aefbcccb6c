"""What other threads leave to an agent's own, above all its manager's requests."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial

import msgspec
import zenoh
from msgspec import Struct

from poise.runtime.agent.supervised import Supervised
from poise.runtime.agent.surroundings import Reply
from poise.wire.records.requests import PROTOCOL, Answer, ManagerRequest, Refused

_MOST = 100


class AgentInbox:
    """What waits for an agent's thread, which does it in order.

    Parameters
    ----------
    computer
        The agent's.
    attend
        Attends to a request, and answers it.
    wake
        Called when something waits, on any thread; must not block.
    supervised
        Does what waits.
    """

    def __init__(
        self,
        computer: str,
        attend: Callable[[ManagerRequest, Reply], None],
        wake: Callable[[], None],
        supervised: Supervised,
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
            spoken = msgspec.msgpack.decode(data, type=_Spoken).protocol
            if spoken != PROTOCOL:
                text = f"manager speaks protocol {spoken}, agent '{self._computer}' "
                text += f"speaks {PROTOCOL}: install the same Poise"
                answer(query, Refused(text))
                return
            request = msgspec.msgpack.decode(data, type=ManagerRequest)
        except msgspec.DecodeError as error:
            answer(query, Refused(f"not a request: {error}"))
            return
        if len(self._waiting) >= _MOST:
            answer(query, Refused(f"over {_MOST} requests wait"))
            return
        self.put(partial(self._attend, request, partial(answer, query)))

    def work(self) -> None:
        """Do all that waits."""
        while self._waiting:
            self._supervised.attempt("requests", self._waiting.popleft())


class _Spoken(Struct, frozen=True):
    """The part that the requests of all protocols share."""

    protocol: int = PROTOCOL


def answer(query: zenoh.Query, said: Answer) -> None:
    """Answer a request, once."""
    query.reply(query.key_expr, msgspec.msgpack.encode(said))
    query.drop()  # type: ignore[no-untyped-call]
