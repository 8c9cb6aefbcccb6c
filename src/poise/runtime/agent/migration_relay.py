"""The migration orders that an agent passes to its containers, until they are answered.

Each is answered once: with its outcome, or with the reason why the container is silent.
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
    processes
        The containers that run, by name.
    """

    def __init__(self, processes: Mapping[str, ContainerProcess]) -> None:
        self._processes = processes
        self._carried: dict[int, _Carried] = {}

    def carry(self, order: Order, query: zenoh.Query, now: float) -> None:
        """Hand an order, which came at `now` [s], to its container."""
        process = self._processes.get(order.container)
        if process is None or process.is_deaf:
            reason = f"container '{order.container}' does not run"
            answer(query, Failed(order.number, reason))
            return
        if process.silence and process.silence.is_stopped:
            answer(query, Failed(order.number, _why_silent(process)))
            return
        process.order(order)
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
            process = self._processes.get(container)
            if process is None or process.is_deaf:
                reason = f"container '{container}' ended"
            elif process.silence and process.silence.is_stopped:
                reason = _why_silent(process)
            elif now > carried.limit:
                reason = f"container '{container}' took over {carried.order.limit:g} s"
                reason = _why_silent(process) if process.silence else reason
            else:
                continue
            self.end(Failed(carried.order.number, reason))

    def limits(self) -> Iterator[float]:
        """Yield the moments at which orders are given up [s]."""
        return (carried.limit for carried in self._carried.values())


def _why_silent(process: ContainerProcess) -> str:
    why = process.silence.reason if process.silence else ""
    return f"container '{process.name}' does not respond: {why}"
