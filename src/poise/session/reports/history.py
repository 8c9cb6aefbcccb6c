"""How a run went from second to second: CPU use, and deadlines that were missed."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct, structs

from poise.manage.agent_connections.statuses import Statuses
from poise.manage.observe.chains import ChainAges, DeadlineMisses, chain_reports
from poise.model.robot import Robot

MOST = 2_000
"""The most moments; of a longer run every second one is dropped, again and again."""


class Moment(Struct, frozen=True, kw_only=True):
    """Shares of CPU used and of deadlines missed in the second before a time."""

    at: float
    cpu_share: Mapping[str, float]
    missed: Mapping[str, float]


class History:
    """Takes a moment of a run every second, of computers `faster` than described."""

    def __init__(self, robot: Robot, faster: Mapping[str, float]) -> None:
        self.moments: list[Moment] = []
        self._robot, self._faster = robot, faster
        self._timers, self._chains = DeadlineMisses(), ChainAges()
        self._before: Statuses = {}
        self._every, self._next = 1.0, 0.0

    def look(self, statuses: Statuses, at: float, now: float) -> None:
        """Take a moment when it is time: `at` since 1970, `now` never goes back [s]."""
        if now < self._next:
            return
        self._next = now + self._every
        timers = self._timers.measure(statuses, now)
        chains = self._chains.measure(chain_reports(self._robot, statuses), now)
        missed = {t.name: t.share for t in timers if t.missed}
        missed |= {c.chain: c.missed / c.used for c in chains if c.missed}
        shares = cpu_shares(self._robot, self._before, statuses, self._faster)
        self._before = dict(statuses)
        self.moments.append(Moment(at=at, cpu_share=shares, missed=missed))
        if len(self.moments) > MOST:
            del self.moments[::2]
            self._every *= 2


def cpu_shares(
    robot: Robot, begin: Statuses, end: Statuses, faster: Mapping[str, float]
) -> dict[str, float]:
    """Return computer -> share of its CPU used between two statuses."""
    shares = {}
    for computer in robot.computers:
        first, last = begin.get(computer.name), end.get(computer.name)
        if first is None or last is None:
            continue
        if first.pid != last.pid:  # its agent was started again, and counts anew
            first = structs.replace(first, cpu=0.0, uptime=0.0)
        if last.uptime <= first.uptime:
            continue
        cores = (last.cpu - first.cpu) / (last.uptime - first.uptime)
        has = computer.capacity["cpu"] * computer.speed * faster.get(computer.name, 1)
        shares[computer.name] = cores / has
    return shares
