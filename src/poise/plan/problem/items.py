"""What a problem consists of: items, edges, bundles, soft limits and time limits."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct


class Item(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A component, as the planner sees it: what is to get a computer.

    Parameters
    ----------
    demand
        Resource -> amount on a computer of speed 1, >= 0; 0 where not named.
    only
        Names of the computers it may run on; empty means any.
    stranded
        Whether none of the computers that it may run on is there.
    present
        The computer where it runs now, or None.
    move_cost
        What F grows by when it does not stay on `present`; >= 0.
    cost
        Computer -> what F grows by when it is there; 0 where not named.
    why
        For people: why `only` is what it is, such as ``"needs device camera"``.
    """

    name: str
    demand: Mapping[str, float] = {}
    only: tuple[str, ...] = ()
    stranded: bool = False
    present: str | None = None
    move_cost: float = 0.0
    cost: Mapping[str, float] = {}
    why: str = ""


class Edge(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A connector between two components; several between the same two add up.

    Parameters
    ----------
    overhead
        Relative overhead when the two are on different computers; >= 0.
    traffic
        What it sends over a link when the two are apart [bytes/s]; >= 0.
    """

    between: tuple[str, str]
    overhead: float = 1.0
    traffic: float = 0.0


class Bundle(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An architecture: components that are of use only all together.

    Parameters
    ----------
    function
        What it provides. Of several architectures with the same function one is chosen.
    priority
        The higher, the later it is suspended when not all fits.
    quality
        How well it provides its function, in (0, 1].
    required
        Whether it is never suspended.
    """

    name: str
    components: tuple[str, ...]
    function: str = ""
    priority: int = 0
    quality: float = 1.0
    required: bool = False


class SoftLimit(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A limit that may be broken, for a price, instead of the hard one.

    A resource that has one on any computer has no hard limit. Several of one resource
    add up, so that a shortage may get dearer the larger it is, or by whom it concerns.

    Parameters
    ----------
    limits
        Computer -> how much of the resource may be used there for nothing, >= 0; where
        not named, what it can use.
    price
        What F grows by for each unit that is used beyond a computer's limit; > 0.
    components
        Those whose demand counts; None means all.
    """

    resource: str
    price: float
    limits: Mapping[str, float] = {}
    components: tuple[str, ...] | None = None


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
