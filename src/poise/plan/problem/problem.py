"""What is to be decided: items, computers, edges and an objective.

A `Problem` knows no robot. It comes from a robot file through `problem_of`, from a JSON
file through `load`, or is written by hand. It is plain data, and correct from birth: a
wrong one raises a RobotError that lists everything that is wrong with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain

from msgspec import Struct

from poise.model.robot import Computer, Link, Objective
from poise.plan.problem.problem_check import check
from poise.plan.problem.time_limit import TimeLimit


class Item(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A component, as the planner sees it: what is to get a computer.

    Parameters
    ----------
    demand
        Resource -> amount on a computer of speed 1, >= 0; 0 where not named.
    only
        Names of the computers it may run on; empty means any.
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
        The higher, the later it is put aside when not all fits.
    quality
        How well it provides its function, in (0, 1].
    required
        Whether it is never put aside.
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


class Problem(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything that a placement is decided by.

    Parameters
    ----------
    links
        What a unit of overhead costs between two computers (`distance`, 1 where there
        is no link), how much their connectors may send together (`bandwidth`,
        unlimited where there is none), and how long a crossing takes (`latency`, 0
        where there is none; for time limits).
    together, apart
        Sets of components that must share a computer, or must not.
    architectures
        Which components belong together as a function; for priorities and
        alternatives. Empty means that every component is needed.
    soft_limits
        Limits that may be broken for a price.
    time_limits
        How long things may take from end to end.
    overhead_scale
        What a unit of overhead counts for in the communication term of the normalised
        scale; None: worked out from the problem. A part of a problem has that of the
        whole, so that F of both can be compared.
    """

    components: tuple[Item, ...] = ()
    computers: tuple[Computer, ...] = ()
    connectors: tuple[Edge, ...] = ()
    links: tuple[Link, ...] = ()
    objective: Objective = Objective()
    together: tuple[tuple[str, ...], ...] = ()
    apart: tuple[tuple[str, ...], ...] = ()
    architectures: tuple[Bundle, ...] = ()
    soft_limits: tuple[SoftLimit, ...] = ()
    time_limits: tuple[TimeLimit, ...] = ()
    overhead_scale: float | None = None

    def __post_init__(self) -> None:
        """Raise a RobotError that lists everything that is wrong."""
        check(self)

    @property
    def resources(self) -> tuple[str, ...]:
        """All resources that a computer has or a component asks for, each once."""
        names = dict.fromkeys(chain.from_iterable(h.capacity for h in self.computers))
        if not set().union(*[c.demand for c in self.components]) <= names.keys():
            for component in self.components:
                names |= dict.fromkeys(component.demand)
        return tuple(names)

    @property
    def usual_connectors(self) -> tuple[Edge, ...]:
        """The connectors where the best architecture of each function runs.

        Of equally good ones that is the one with the least overhead.
        """
        groups: dict[str, list[Bundle]] = {}
        for a in self.architectures:
            groups.setdefault(a.function or f"\0{a.name}", []).append(a)
        if len(groups) == len(self.architectures):
            return self.connectors
        usual = [
            group[0] if len(group) == 1 else min(group, key=self._how_usual)
            for group in groups.values()
        ]
        lesser = {name for a in self.architectures for name in a.components}
        lesser.difference_update(*(a.components for a in usual))
        return tuple(k for k in self.connectors if lesser.isdisjoint(k.between))

    def _how_usual(self, bundle: Bundle) -> tuple[float, float]:
        inside = {*bundle.components}
        own = (k for k in self.connectors if not inside.isdisjoint(k.between))
        return -bundle.quality, sum(k.overhead for k in own)
