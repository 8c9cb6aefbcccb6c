"""What was done to a robot that was broken at random, and what came of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from msgspec import Struct

from examples.demo.overlaps import Overlap
from poise.units import format_bytes, format_seconds
from tests.chaos.faults import Fault

GRACE = 1.0
"""A handler that runs when its component's lease ends is over within this time, unless
its agent, which ends it, is stopped or has ended [s]."""
MESSAGES = ("received", "lost", "doubled", "reordered", "beside")
_BEFORE = 2.0
"""A fault may have caused what happens up to this time after it [s]: leases end."""
_SETTLES = 5.0
"""A computer that somebody took over by force is as the first manager wants it within
this time [s]."""


class ChaosReport(Struct, kw_only=True):
    """What was done to a robot, and what came of it.

    Parameters
    ----------
    seed
        Of what happened when.
    events
        What was done -> how often.
    trouble
        What must not be: what hung, was active twice, was left over, came twice or in
        another order.
    settled
        How long each healed robot took to be as its file says [s].
    received, lost, doubled, reordered
        Messages, over all receivers.
    beside
        Messages that an incarnation published while a later one did, too.
    answered, refused
        Calls.
    overlaps
        How often two incarnations of a component worked at the same time, though nobody
        forced it.
    unfinished
        How often the older one did no more than to finish a handler.
    forced
        How often they did after `--take-over` on one side of a cut.
    growth, grew
        The most by which the memory of a process grew after `WARM` [bytes], and which.
    """

    seed: int
    events: Counter[str]
    trouble: list[str]
    settled: list[float]
    received: int = 0
    lost: int = 0
    doubled: int = 0
    reordered: int = 0
    beside: int = 0
    answered: int = 0
    refused: int = 0
    overlaps: int = 0
    unfinished: int = 0
    forced: int = 0
    growth: int = 0
    grew: str = "no process"

    def judge(
        self, overlaps: Iterable[Overlap], faults: Iterable[Fault], began: float
    ) -> None:
        """Count overlaps, and note which of them break a promise.

        Parameters
        ----------
        began
            When the run began [s, by the clock of the machine].
        """
        faults = list(faults)
        for overlap in overlaps:
            near = [f for f in faults if _is_near(f, overlap, _BEFORE)]
            if any(_forces(fault, overlap) for fault in faults):
                self.forced += 1
                continue
            self.overlaps += 1
            self.unfinished += not overlap.begun
            older = overlap.computers[0]
            has_agent = not any(f.stops_agent and f.on == older for f in near)
            if overlap.begun or (has_agent and overlap.went_on > GRACE):
                causes = "; ".join(map(str, near)) or "nothing"
                at = overlap.since - began
                self.trouble.append(f"{at:.1f} s: {overlap}; in force: {causes}")

    def __str__(self) -> str:
        """Return it as text."""

        def counts(*names: str) -> str:
            return ", ".join(f"{getattr(self, name)} {name}" for name in names)

        events = ", ".join(f"{n} x {what}" for what, n in self.events.most_common())
        settled = [format_seconds(value) for value in sorted(self.settled)]
        lines = [
            f"seed: {self.seed}",
            f"faults: {events}",
            f"settled {len(settled)} times: {', '.join(settled)}",
            f"incarnations at once: {counts('overlaps', 'unfinished', 'forced')}",
            f"messages: {counts(*MESSAGES)}",
            f"calls: {counts('answered', 'refused')}",
            f"memory: grown at most by {format_bytes(self.growth)}: {self.grew}",
            *(self.trouble or ["no trouble"]),
        ]
        return "\n".join(lines)


def _forces(fault: Fault, overlap: Overlap) -> bool:
    """Return whether a person let a manager run there what runs elsewhere."""
    is_there = fault.forced and fault.on in overlap.computers
    return is_there and _is_near(fault, overlap, _SETTLES)


def _is_near(fault: Fault, overlap: Overlap, seconds: float) -> bool:
    """Return whether a fault was in force when an overlap began, or little before."""
    return fault.since <= overlap.since <= fault.until + seconds
