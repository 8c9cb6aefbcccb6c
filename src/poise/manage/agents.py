"""The robot's agents as the manager sees them: what they say, whether they live."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from queue import Empty, SimpleQueue
from typing import Self, TypeVar

import msgspec
import zenoh
from zenoh.handlers import Callback

from poise.clock import Clock
from poise.errors import RunError
from poise.priority import first
from poise.wire.control_session import open_session
from poise.wire.records.deployment import (
    Accepted,
    AgentStatus,
    Answer,
    Deployment,
    Refused,
    Request,
)
from poise.wire.records.migration import Done, Failed, Order, Outcome
from poise.wire.records.samples import AgentSample

log = logging.getLogger(__name__)

MARGIN = 0.1
"""An agent's answer to an order may come so much after the order's limit [s]."""
_LAST_WORD = 1.0
"""So long after the limit of an order zenoh may tell that no answer came [s]."""
_LOOK = 0.1
ANSWER_LIMIT = 2.0
"""An agent answers a deployment within this time [s]."""
_NEWS = 0.5
"""That an agent is lost is known so long [s] after its connection ends, at most."""


S = TypeVar("S")
_Said = SimpleQueue[tuple[int, zenoh.Reply | None]]
"""What zenoh's threads say: of which order, and an answer, or None at its end."""


class Agents:
    """The agents of one robot. Use it as a context manager.

    Parameters
    ----------
    robot
        The robot's name.
    endpoints
        Computer -> zenoh endpoint of its agent.
    on_sample
        Called with every sample, on zenoh's thread; must not block.
    lease
        An agent that is cut off counts as lost after this time [s]; one that ends, at
        once.
    """

    def __init__(
        self,
        robot: str,
        endpoints: Mapping[str, str],
        clock: Clock,
        on_sample: Callable[[AgentSample], object] | None = None,
        lease: float = 1.0,
    ) -> None:
        self._prefix = f"poise/{robot}"
        self._clock = clock
        self._changed = threading.Condition()
        self._statuses: dict[str, AgentStatus] = {}
        self._alive: set[str] = set()
        self._lost: set[str] = set()
        # no gossip: it talks to the agents that it was told of, and to no other manager
        with first():  # zenoh's threads only carry
            self._session = open_session(
                connect=tuple(endpoints.values()), gossip=False, lease=lease
            )
        self._declared = [
            self._session.declare_subscriber(
                f"{self._prefix}/status/*", _reading(AgentStatus, self._on_status)
            ),
            self._session.liveliness().declare_subscriber(
                f"{self._prefix}/alive/*", self._on_alive, history=True
            ),
        ]
        if on_sample is not None:
            self._declared.append(
                self._session.declare_subscriber(
                    f"{self._prefix}/samples/*", _reading(AgentSample, on_sample)
                )
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the agents as they are."""
        self._session.close()  # type: ignore[no-untyped-call]

    def statuses(self) -> dict[str, AgentStatus]:
        """Return what each agent said last, by computer."""
        with self._changed:
            return dict(self._statuses)

    def lost(self) -> frozenset[str]:
        """Return the computers whose agents were there and are no more."""
        with self._changed:
            return frozenset(self._lost)

    def wait_alive(
        self,
        computers: Iterable[str],
        limit: float,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """Wait until the agents of all `computers` are there and said how they are.

        Parameters
        ----------
        check
            Called now and then; may raise to end the waiting.

        Raises
        ------
        RunError
            One was not there within `limit` [s].
        """
        wanted, deadline = set(computers), self._clock.now() + limit
        while not self._wait(lambda: wanted <= self._there(), _LOOK):
            check()
            if self._clock.now() < deadline:
                continue
            missing = ", ".join(sorted(wanted - self._there()))
            raise RunError(
                f"no agent answered within {limit:g} s on: {missing}. Is `poise agent` "
                "running there, and can this computer reach it?"
            )

    def wait_news(self, is_enough: Callable[[], bool], limit: float) -> bool:
        """Wait until `is_enough` says so, asked at every news; whether it did.

        `is_enough` may raise to end the waiting; `limit` is in [s].
        """
        return self._wait(is_enough, limit)

    def deploy(self, deployments: Mapping[str, Deployment]) -> dict[str, str]:
        """Tell agents what should run, all at once; by computer.

        Returns
        -------
        Computer -> why its agent did not take it within `ANSWER_LIMIT`; empty when all
        did.
        """
        asked = [
            (computer, self._ask(computer, deployment, ANSWER_LIMIT))
            for computer, deployment in deployments.items()
        ]
        refusals = {
            computer: self._refusal(computer, replies) for computer, replies in asked
        }
        return {
            computer: f"the agent of '{computer}' {refusal}"
            for computer, refusal in refusals.items()
            if refusal
        }

    def order(self, orders: Iterable[tuple[str, Order]]) -> Iterator[Outcome]:
        """Tell containers to take steps, all at once; yield what came of each.

        The first to be known comes first, and nobody need wait for the others.

        Parameters
        ----------
        orders
            Computers and orders. An agent that does not answer counts as failed.
        """
        said: _Said = SimpleQueue()
        began = self._clock.now()
        asked = {order.number: (computer, order) for computer, order in orders}
        for number, (computer, order) in asked.items():
            self._session.get(
                f"{self._prefix}/agent/{computer}",
                Callback(partial(_note, said, number), partial(_note, said, number)),
                payload=msgspec.msgpack.encode(order),
                timeout=order.limit + MARGIN,
            )
        return self._outcomes(asked, said, began)

    def _outcomes(
        self,
        asked: dict[int, tuple[str, Order]],
        said: _Said,
        began: float,
    ) -> Iterator[Outcome]:
        limit = max((order.limit for _, order in asked.values()), default=0.0)
        while asked:
            try:
                number, reply = said.get(timeout=limit + _LAST_WORD)
            except Empty:  # zenoh did not even tell that the time is over
                number, reply = next(iter(asked)), None
            if number in asked:
                computer, order = asked.pop(number)
                yield self._outcome(computer, order, reply, began)

    def _ask(
        self, computer: str, request: Request, limit: float
    ) -> Iterable[zenoh.Reply]:
        return self._session.get(
            f"{self._prefix}/agent/{computer}",
            payload=msgspec.msgpack.encode(request),
            timeout=limit,
        )

    def _refusal(self, computer: str, replies: Iterable[zenoh.Reply]) -> str:
        """Return why an agent did not take a deployment; empty when it did."""
        answer = _answer(replies)
        if isinstance(answer, Accepted):
            return ""
        if answer is None:
            return self._why_silent(computer, ANSWER_LIMIT, _NEWS)
        why = answer.reason if isinstance(answer, Refused) else str(answer)
        return f"refused: {why}"

    def _outcome(
        self, computer: str, order: Order, reply: zenoh.Reply | None, began: float
    ) -> Outcome:
        """Return what came of an order that was given at `began` [s]."""
        answer = _answer(() if reply is None else (reply,))
        if isinstance(answer, Done | Failed):
            return answer
        if answer is None:
            limit = order.limit + MARGIN
            # a gate may be shut: who was waited for has had time enough
            left = max(0.0, began + limit - self._clock.now())
            why = self._why_silent(computer, limit, min(_NEWS, left))
        else:
            why = f"answered {answer}"
        return Failed(order.number, f"the agent of '{computer}' {why}")

    def _why_silent(self, computer: str, limit: float, patience: float) -> str:
        """Return what is known of an agent that gave no answer within `limit` [s].

        The answer fails to come as soon as its connection ends, which may be a little
        before zenoh tells that the agent is lost: `patience` [s] is for that.
        """
        if self._wait(lambda: computer in self._lost, patience):
            return "is gone"
        return f"did not answer within {limit:g} s"

    def _wait(self, is_enough: Callable[[], bool], limit: float) -> bool:
        with self._changed:
            return self._changed.wait_for(is_enough, limit)

    def _there(self) -> set[str]:
        return self._alive & self._statuses.keys()

    def _on_status(self, status: AgentStatus) -> None:
        with self._changed:
            self._statuses[status.computer] = status
            self._changed.notify_all()

    def _on_alive(self, sample: zenoh.Sample) -> None:
        computer = str(sample.key_expr).rpartition("/")[2]
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._alive.add(computer)
                self._lost.discard(computer)
            elif computer in self._alive:
                self._alive.discard(computer)
                self._lost.add(computer)
            self._changed.notify_all()


def _reading(type_: type[S], take: Callable[[S], object]) -> Callable[..., None]:
    """Return what takes the records of a type that agents say; others are logged."""
    decode = msgspec.msgpack.Decoder(type_).decode

    def hear(sample: zenoh.Sample) -> None:
        try:
            record = decode(sample.payload.to_bytes())
        except msgspec.DecodeError as error:
            log.warning("%s: refused: %s", sample.key_expr, error)
        else:
            take(record)

    return hear


def _note(said: _Said, number: int, reply: zenoh.Reply | None = None) -> None:
    said.put((number, reply))


def _decoded(sample: zenoh.Sample) -> Accepted | Refused | Done | Failed:
    """Return an agent's answer; `Refused` when it is none."""
    try:
        answer: Accepted | Refused | Done | Failed = msgspec.msgpack.decode(
            sample.payload.to_bytes(), type=Answer
        )
    except msgspec.DecodeError as error:
        return Refused(f"not an answer: {error}")
    return answer


def _answer(
    replies: Iterable[zenoh.Reply],
) -> Accepted | Refused | Done | Failed | None:
    """Return the first answer of an agent; `None` when it gave none."""
    return next((_decoded(reply.ok) for reply in replies if reply.ok is not None), None)
