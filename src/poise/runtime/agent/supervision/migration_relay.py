"""The requests that an agent passes to its containers, until they are answered.

Each batch is answered once: with its outcome, or with why its container is silent.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.runtime.agent.supervision.container_processes import ContainerProcess
from poise.runtime.agent.surroundings import Reply
from poise.wire.records.container import Order, Outcome
from poise.wire.records.migration import StepsFailed


class _Pending(Struct, frozen=True):
    steps: Order
    reply: Reply
    limit: float


class MigrationRelay:
    """The migration steps and taps in progress in one agent's containers.

    Parameters
    ----------
    processes
        The containers that run, by name.
    """

    def __init__(self, processes: Mapping[str, ContainerProcess]) -> None:
        self._processes = processes
        self._pending: dict[int, _Pending] = {}

    def pass_on(self, steps: Order, reply: Reply, now: float) -> None:
        """Pass steps or a tap, which came at `now` [s], to their container."""
        process = self._processes.get(steps.container)
        if process is None or process.is_deaf:
            reason = f"container '{steps.container}' does not run"
            reply(StepsFailed(steps.number, reason))
            return
        if process.is_stuck():
            reply(StepsFailed(steps.number, _why_silent(process)))
            return
        process.take_steps(steps)
        self._pending[steps.number] = _Pending(steps, reply, now + steps.limit)

    def end(self, outcome: Outcome) -> None:
        """Answer with an outcome, unless that was answered before."""
        pending = self._pending.pop(outcome.number, None)
        if pending is not None:
            pending.reply(outcome)

    def give_up(self, now: float) -> None:
        """Answer for containers that are gone, silent or too slow at `now` [s]."""
        for pending in list(self._pending.values()):
            container = pending.steps.container
            process = self._processes.get(container)
            if process is None or process.is_deaf:
                reason = f"container '{container}' ended"
            elif process.is_stuck():
                reason = _why_silent(process)
            elif now > pending.limit:
                reason = f"container '{container}' took over {pending.steps.limit:g} s"
                reason = _why_silent(process) if process.silence else reason
            else:
                continue
            self.end(StepsFailed(pending.steps.number, reason))

    def moment(self) -> float:
        """Return when the next steps are given up [s]."""
        limits = (pending.limit for pending in self._pending.values())
        return min(limits, default=float("inf"))


def _why_silent(process: ContainerProcess) -> str:
    why = process.silence.reason if process.silence else ""
    return f"container '{process.name}' does not respond: {why}"
