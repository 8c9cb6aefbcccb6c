"""The orders that an agent carries to its containers, until they are answered.

Each is answered once: with what its container says of it, or with why that is silent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import zenoh
from msgspec import Struct

from poise.runtime.agent.container_processes import ContainerProcess
from poise.runtime.agent.inbox import answer
from poise.wire.records.migration import Failed, Order, Outcome


class _Carried(Struct, frozen=True):
    order: Order
    query: zenoh.Query
    limit: float


class MigrationRelay:
    """The orders under way in one agent's containers.

    Parameters
    ----------
    children
        The containers that run, by name.
    """

    def __init__(self, children: Mapping[str, ContainerProcess]) -> None:
        self._children = children
        self._carried: dict[int, _Carried] = {}

    def carry(self, order: Order, query: zenoh.Query, now: float) -> None:
        """Hand an order, which came at `now` [s], to its container."""
        child = self._children.get(order.container)
        if child is None or child.is_deaf:
            reason = f"container '{order.container}' does not run"
            answer(query, Failed(order.number, reason))
            return
        child.order(order)
        self._carried[order.number] = _Carried(order, query, now + order.limit)

    def end(self, outcome: Outcome) -> None:
        """Answer with what came of an order, if nothing was said of it before."""
        carried = self._carried.pop(outcome.number, None)
        if carried is not None:
            answer(carried.query, outcome)

    def give_up(self, now: float) -> None:
        """Answer those whose container went away, or took too long at `now` [s]."""
        for carried in list(self._carried.values()):
            container = carried.order.container
            child = self._children.get(container)
            if child is None or child.is_deaf:
                reason = f"container '{container}' ended"
            elif now > carried.limit:
                reason = f"container '{container}' took over {carried.order.limit:g} s"
            else:
                continue
            self.end(Failed(carried.order.number, reason))

    def limits(self) -> Iterator[float]:
        """Yield the moments at which orders are given up [s]."""
        return (carried.limit for carried in self._carried.values())
