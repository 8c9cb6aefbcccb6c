"""The faults that agents reported after some moment. Pure.

Agents number their faults and keep them for as long as they live, also over robots, so
whoever looks for new ones remembers the numbers of those before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from poise.wire.records.deployment import AgentStatus, Fault

Statuses = Mapping[str, AgentStatus]
Numbers = Mapping[str, int]
"""Computer -> the number of its agent's last fault."""


def last_numbers(statuses: Statuses) -> Numbers:
    """Return the numbers of the last faults that `statuses` hold."""
    return {
        computer: max((fault.number for fault in status.faults), default=0)
        for computer, status in statuses.items()
    }


def faults_after(before: Numbers, statuses: Statuses) -> Iterator[tuple[str, Fault]]:
    """Yield computers and their faults after `before`, oldest first."""
    now = last_numbers(statuses)
    for computer, status in sorted(statuses.items()):
        known = before.get(computer, 0)
        is_new_agent = now[computer] < known
        for fault in status.faults:
            if is_new_agent or fault.number > known:
                yield computer, fault


def fault_sentence(computer: str, fault: Fault) -> str:
    """Return a fault for people."""
    restarts = f" (restarts before: {fault.restarts})" if fault.restarts else ""
    return f"container '{fault.container}' on '{computer}' {fault.message}{restarts}"
