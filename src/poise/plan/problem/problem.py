"""What is to be decided: items, computers, edges and an objective.

A `Problem` knows no robot. It comes from a robot file through `problem_of`, from a JSON
file through `load`, or is written by hand. It is plain data, and correct from birth: a
wrong one raises a RobotError that lists everything that is wrong with it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from math import inf
from pathlib import Path
from typing import get_args

import msgspec
from msgspec import Struct, ValidationError, structs, to_builtins

from poise.decoding import convert, from_json
from poise.errors import RobotError, unknown
from poise.model.robot import Computer, Link, Objective, Scale, Spread
from poise.model.schema import flush_left
from poise.plan.problem.items import Bundle, Edge, Item, SoftLimit, TimeLimit


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
    exclusive
        Device -> components of which only one runs at a time, as each uses it alone.
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
    exclusive: Mapping[str, tuple[str, ...]] = {}
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
        every = needs(self)
        if len(every) == len(self.architectures):
            return self.connectors
        usual = [
            need[0] if len(need) == 1 else min(need, key=self._how_usual)
            for need in every
        ]
        lesser = {name for a in self.architectures for name in a.components}
        lesser.difference_update(*(a.components for a in usual))
        return tuple(k for k in self.connectors if lesser.isdisjoint(k.between))

    def _how_usual(self, bundle: Bundle) -> tuple[float, float]:
        inside = {*bundle.components}
        own = (k for k in self.connectors if not inside.isdisjoint(k.between))
        return -bundle.quality, sum(k.overhead for k in own)


Need = tuple[Bundle, ...]
"""What is to be provided: by any one of these, the best first."""


def needs(problem: Problem) -> list[Need]:
    """Return what is to be provided: each by any one of several architectures."""
    groups: dict[str, list[Bundle]] = {}
    for bundle in problem.architectures:
        groups.setdefault(bundle.function or f"\0{bundle.name}", []).append(bundle)
    return [tuple(sorted(g, key=lambda a: -a.quality)) for g in groups.values()]


LEAST, MOST = 1e-30, 1e30
"""Numbers beyond these would overflow as they are divided, squared and summed."""


def check(problem: Problem) -> None:
    """Raise a RobotError that lists everything that is wrong with `problem`."""
    try:
        wrong = list(problems(problem))
    except (AttributeError, TypeError, ValueError):
        _check_types(problem)
        raise
    if wrong:
        raise RobotError("the problem is wrong:\n  " + "\n  ".join(wrong))


def _check_types(problem: Problem) -> None:
    for field in structs.fields(problem):
        try:
            convert(to_builtins(getattr(problem, field.name)), field.type)
        except (ValidationError, TypeError, OverflowError) as error:
            text = str(error).replace("`$", f"`{field.name}")
            raise RobotError(f"the problem is wrong: {text}") from None


def problems(problem: Problem) -> Iterator[str]:
    """Yield everything that is wrong, each named with its value and the choices."""
    if texts := list(_texts(problem)):
        yield from texts  # all else would read them letter by letter
        return
    components = [c.name for c in problem.components]
    computers = [h.name for h in problem.computers]
    yield from _twice("component", components)
    yield from _twice("computer", computers)
    yield from _twice("architecture", [a.name for a in problem.architectures])
    if components and not computers:
        yield f"there are {len(components)} components, but no computers"
    yield from _numbers(problem)
    yield from _names(problem, components, computers)
    yield from _groups(problem)


def _texts(problem: Problem) -> Iterator[str]:
    """Yield where one name stands that should be several."""
    for where, names in _lists(problem):
        if isinstance(names, str):
            yield f"{where} is the text {names!r}, must be names, such as [{names!r}]"


def _lists(problem: Problem) -> Iterator[tuple[str, object]]:
    """Yield where several names should be, and what is there."""
    for c in problem.components:
        yield f"component {c.name!r}: only", c.only
    for k in problem.connectors:
        yield "connector: between", k.between
    for link in problem.links:
        yield "link: between", link.between
    for a in problem.architectures:
        yield f"architecture {a.name!r}: components", a.components
    for s in problem.soft_limits:
        yield f"soft limit of {s.resource}: components", s.components or ()
    for t in problem.time_limits:
        for hop in t.hops:
            yield f"time limit {t.name!r}: a hop: between", hop.between
    sets: Mapping[str, Iterable[object]] = _sets(problem)
    for kind, groups in sets.items():
        yield kind, groups
        if not isinstance(groups, str):  # else each of its letters were a set
            yield from ((f"{kind}: a set", group) for group in groups)


def _sets(problem: Problem) -> Mapping[str, Iterable[tuple[str, ...]]]:
    """Return kind -> the sets of components that limit each other."""
    return {
        "together": problem.together,
        "apart": problem.apart,
        "exclusive": problem.exclusive.values(),
    }


def _twice(kind: str, names: Sequence[object]) -> Iterator[str]:
    for name, count in Counter(names).items():
        if count > 1:
            yield f"{kind} {name!r} is there {count} times; names must be unique"
        if not isinstance(name, str):
            yield f"{kind} {name!r}: a name must be text"


def _numbers(problem: Problem) -> Iterator[str]:
    for c in problem.components:
        where = f"component {c.name!r}: "
        yield from _amounts(f"{where}demand of ", c.demand)
        yield from _amounts(where, {"move_cost": c.move_cost})
        sizes = {name: abs(cost) for name, cost in c.cost.items()}
        yield from _amounts(f"{where}the size of its cost on ", sizes)
    for h in problem.computers:
        where = f"computer {h.name!r}: "
        yield from _amounts(f"{where}capacity of ", h.capacity)
        yield from _amounts(where, {"price": h.price, "speed": h.speed})
        if h.speed == 0:
            yield f"{where}speed is 0, must be above 0"
        for name, share in h.reserve.items():
            if not 0 <= share < 1:
                yield f"{where}reserve of {name} is {share}, must be in [0, 1)"
    for k in problem.connectors:
        where = f"connector {' - '.join(k.between)}: "
        yield from _amounts(where, {"overhead": k.overhead, "traffic": k.traffic})
    for link in problem.links:
        where = f"link {' - '.join(link.between)}: "
        yield from _amounts(where, {"distance": link.distance, "latency": link.latency})
        if link.bandwidth != inf:
            yield from _amounts(where, {"bandwidth": link.bandwidth})
    yield from _soft_limits(problem)
    if problem.time_limits:
        yield from _time_limits(problem.time_limits)
    yield from _weights(problem)


def _soft_limits(problem: Problem) -> Iterator[str]:
    for s in problem.soft_limits:
        where = f"soft limit of {s.resource}: "
        yield from _amounts(f"{where}limit of ", s.limits)
        yield from _amounts(where, {"price": s.price})
        if s.price == 0:
            yield f"{where}price is 0, must be above 0"


def _time_limits(limits: Sequence[TimeLimit]) -> Iterator[str]:
    yield from _twice("time limit", [t.name for t in limits])
    for t in limits:
        where = f"time limit {t.name!r}: "
        yield from _amounts(where, {"fixed": t.fixed, "price": t.price})
        yield from _amounts(where, {"limit": t.limit})
        if t.limit == 0:
            yield f"{where}limit is 0, must be above 0"
        for run in t.runs:
            part = f"{where}run of {run.component}: "
            yield from _amounts(part, {"seconds": run.seconds})
        for hop in t.hops:
            ends: Sequence[str] = hop.between
            if len(ends) != 2:  # noqa: PLR2004 - two ends
                names = ", ".join(ends)
                yield f"{where}hop between {names}: it must join two components"
            numbers = ("seconds", "crossings", "size")
            amounts = {name: getattr(hop, name) for name in numbers}
            yield from _amounts(f"{where}hop {' - '.join(ends)}: ", amounts)


def _weights(problem: Problem) -> Iterator[str]:
    given = problem.objective
    for name, value, choices in (
        ("scale", given.scale, get_args(Scale)),
        ("spread", given.spread, get_args(Spread)),
    ):
        if value not in choices:
            known = " or ".join(choices)
            yield f"objective: {name} is {value!r}, must be {known}"
    scale = problem.overhead_scale  # of extreme overhead it is beyond other numbers
    if scale is not None and not 0 <= scale < inf:
        yield f"overhead_scale is {_shown(scale)}, must be finite and >= 0"
    terms = ("communication", "balance", "quality")
    yield from _amounts("objective: ", {term: getattr(given, term) for term in terms})
    yield from _amounts("objective: weight of ", given.weights)
    yield from _amounts("objective: size of ", given.sizes)
    for a in problem.architectures:
        if not 0 < a.quality <= 1:
            yield f"architecture {a.name!r}: quality is {a.quality}, must be in (0, 1]"
        yield from _whole(f"architecture {a.name!r}: priority", a.priority)


def _amounts(what: str, amounts: Mapping[str, float]) -> Iterator[str]:
    for name, value in amounts.items():
        if not (value == 0 or LEAST <= value <= MOST):
            yield f"{what}{name} is {_shown(value)}, must be 0, or {_RANGE}"


def _whole(what: str, value: object) -> Iterator[str]:
    if not isinstance(value, int):
        yield f"{what} is {value!r}, must be a whole number"


_RANGE = f"in [{LEAST:g}, {MOST:g}]"


def _shown(value: float) -> str:
    # A whole number in Python may have more digits than anybody wants to read.
    if isinstance(value, int) and abs(value) > MOST:
        return f"{'-' if value < 0 else ''}1e{abs(value).bit_length() * 3 // 10}..."
    return str(value)


def _groups(problem: Problem) -> Iterator[str]:
    """Yield sets in which something is there twice, and pairs that are none."""
    for kind, groups in _sets(problem).items():
        for group in groups:
            for name, count in Counter(group).items():
                if count > 1:
                    yield f"{kind}: {name!r} is there {count} times"
    for connector in problem.connectors:
        ends: Sequence[str] = connector.between
        if len(ends) != 2:  # noqa: PLR2004 - two ends
            yield f"connector between {', '.join(ends)}: it must join two components"
    for link in problem.links:
        if len(set(link.between)) != 2:  # noqa: PLR2004 - two ends
            names = ", ".join(link.between)
            yield f"link between {names}: it must join two computers"


def _names(
    problem: Problem, components: list[str], computers: list[str]
) -> Iterator[str]:
    known = {"component": {*components}, "computer": {*computers}}
    choices = {"component": components, "computer": computers}
    for where, kind, names in _mentions(problem):
        for name in names:
            if name not in known[kind]:
                yield f"{where}: {unknown(kind, name, choices[kind])}"


def _mentions(problem: Problem) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield where names are used, of which kind, and the names."""
    for c in problem.components:
        present = () if c.present is None else (c.present,)
        yield f"component {c.name!r}", "computer", (*c.only, *c.cost, *present)
    for k in problem.connectors:
        yield f"connector {' - '.join(k.between)}", "component", k.between
    for link in problem.links:
        yield f"link {' - '.join(link.between)}", "computer", link.between
    for kind, groups in _sets(problem).items():
        for group in groups:
            yield kind, "component", group
    for a in problem.architectures:
        yield f"architecture {a.name!r}", "component", a.components
    for s in problem.soft_limits:
        yield f"soft limit of {s.resource}", "computer", (*s.limits,)
        yield f"soft limit of {s.resource}", "component", s.components or ()
    for t in problem.time_limits:
        yield f"time limit {t.name!r}", "component", t.components


def load(path: str | Path) -> Problem:
    """Return the problem in the JSON file at `path`.

    Raises
    ------
    RobotError
        When it cannot be read or anything in it is wrong; the message lists all.
    """
    try:
        return from_json(Path(path).read_bytes(), Problem)
    except OSError as error:
        raise RobotError(f"{path}: {error.strerror or error}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RobotError(f"{path}: {error}") from error
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from None


def schema() -> str:
    """Return the JSON Schema of what `load` reads, as indented JSON."""
    keys = msgspec.json.schema(Problem)
    whole = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **keys,
        "$defs": flush_left(keys["$defs"]),
    }
    return msgspec.json.format(msgspec.json.encode(whole), indent=2).decode() + "\n"
