"""Limits of how long something may take from end to end, by where its parts run."""

from __future__ import annotations

from msgspec import Struct


class Run(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run of a component's code, as part of a time limit.

    Parameters
    ----------
    seconds
        CPU time on a computer of speed 1 [s]; >= 0.
    """

    component: str
    seconds: float


class Hop(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A way between two components: what it takes when they are apart.

    Parameters
    ----------
    seconds
        What it takes beyond what it takes on one computer, whatever the link [s]; >= 0.
    crossings
        How often the link's latency is waited for: 1 for a message, 2 for a call.
    size
        What goes over the link meanwhile [bytes]; >= 0.
    """

    between: tuple[str, str]
    seconds: float = 0.0
    crossings: float = 1.0
    size: float = 0.0


class TimeLimit(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How long something may take on a placement: a chain's data, or a timer's run.

    It takes `fixed`, the seconds of each run divided by the speed of its computer, and
    of each hop whose ends are apart its seconds, its crossings times the link's
    latency, and its size divided by the link's bandwidth.

    Parameters
    ----------
    limit
        How long it may take [s]; > 0.
    fixed
        What it takes on any placement [s]; >= 0.
    shared
        Whether runs take longer the busier their computer is
        (docs/design/objective.md).
    price
        What F grows by for each share of `limit` beyond it; 0: it must be kept.
    """

    name: str
    limit: float
    fixed: float = 0.0
    runs: tuple[Run, ...] = ()
    hops: tuple[Hop, ...] = ()
    shared: bool = False
    price: float = 0.0

    @property
    def components(self) -> tuple[str, ...]:
        """All components that have a part in it, each once."""
        used = [run.component for run in self.runs]
        used += [end for hop in self.hops for end in hop.between]
        return tuple(dict.fromkeys(used))
