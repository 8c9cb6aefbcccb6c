"""The modelled world, and what must always hold in it."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from poise.wire.records.migration_records import Before

MARK = 0
"""A mark in a stream of messages, which are numbered from 1."""

Side = Literal["old", "new"]
Stream = tuple[float, ...]


class Bounds(NamedTuple):
    """How much happens in the model."""

    messages: int = 2
    callers: str = ""
    """A letter each (`tests.model_of_moves.calls`)."""
    movers: int = 1
    """Neighbours that move at once: the first sends to the second."""
    speaks: bool = False
    """Whether `activate` of the last of them publishes a message."""
    kills: int = 0
    gives_up: int = 0
    """How often the manager gives a round up."""
    late: bool = True
    """Whether orders that were given up may be taken later."""
    prepares: bool = False
    """Whether it begins with the preparation; else after it."""
    killed: str = "SonD"
    """Containers that may be killed: source, old, new, sink; O, N: all old or new ones
    at once, with their agent."""

    @property
    def is_circle(self) -> bool:
        """Whether the movers call each other."""
        return {"d", "u"} <= set(self.callers)

    def levels(self) -> list[list[int]]:
        """Return in which order the movers come to rest (`topological_order`)."""
        if self.is_circle or not {"d", "u"} & set(self.callers):
            return [list(range(self.movers))]
        return [[0], [1]] if "d" in self.callers else [[1], [0]]


class Incarnation(NamedTuple):
    """A moved component in one container (`poise.runtime.hosting.runner.Runner`).

    `phase`: inactive, ready (activated, paused), work, rest, gone, dead; `party`: the
    phase of the migration that it has reached (`MigrationPhases`).
    """

    phase: str
    stays: bool = False
    is_redirected: bool = False
    gives: bool = False
    inside: int = -1
    """The caller whose chain is inside; -1: none."""
    outside: tuple[int, ...] = ()
    """Callers whose chains stepped out, while they wait in a call."""
    inbox: Stream = ()
    log: Stream = ()
    """Its state: what it has worked on."""
    kept_back: Stream = ()
    """What `activate` published: it goes out when the component works."""
    is_marked: bool = False
    party: Before = "prepare"


class Order(NamedTuple):
    """The steps of one round for one container, so far as they are not taken."""

    container: str
    steps: tuple[str, ...]
    outcome: str = "sent"


class State(NamedTuple):
    """All of the modelled world."""

    olds: tuple[Incarnation, ...]
    news: tuple[Incarnation, ...]
    # what is under way to each of them, and at last to the sink
    to_olds: tuple[Stream, ...]
    to_news: tuple[Stream, ...]
    # the manager
    round: str = "transfer 0"
    orders: tuple[Order, ...] = ()
    late: frozenset[Order] = frozenset()
    """Orders for which nobody waits, and that may still be taken."""
    spec: str = "both"
    """What agents were told: both, only old, only new."""
    told: frozenset[str] = frozenset()
    """The containers of moved components that heard it."""
    # the source's outlet
    applied: str = "both"
    path: Side = "old"
    held: Stream | None = None
    sent: int = 0
    is_source_dead: bool = False
    is_sink_marked: bool = False
    is_sink_dead: bool = False
    got: Stream = ()
    """What the sink received."""
    calls: tuple[tuple[str, str], ...] = ()
    """Each caller: where it is, and its path."""
    runs: tuple[tuple[tuple[int, int], int], ...] = ()
    """How often each caller's chain entered each component."""
    excused: frozenset[float] = frozenset()
    """Messages that were in a container when it was killed."""
    kills: int = 0
    given_up: int = 0

    def one(self, side: Side, which: int) -> Incarnation:
        """Return an incarnation."""
        return (self.olds if side == "old" else self.news)[which]

    def with_one(self, side: Side, which: int, one: Incarnation) -> State:
        """Return the state with another incarnation."""
        ones = _with(self.all_of(side), which, one)
        return self._replace(olds=ones) if side == "old" else self._replace(news=ones)

    def all_of(self, side: str) -> tuple[Incarnation, ...]:
        """Return the incarnations of one side."""
        return self.olds if side == "old" else self.news

    def streams(self, side: str) -> tuple[Stream, ...]:
        """Return what is under way on one side."""
        return self.to_olds if side == "old" else self.to_news

    def flowing(self, side: Side, to: int, *items: float) -> State:
        """Return the state with more under way."""
        return self.with_stream(side, to, (*self.streams(side)[to], *items))

    def with_stream(self, side: Side, to: int, stream: Stream) -> State:
        """Return the state with something else under way."""
        all_ = _with(self.streams(side), to, stream)
        if side == "old":
            return self._replace(to_olds=all_)
        return self._replace(to_news=all_)


def _with(things: tuple[Any, ...], which: int, thing: object) -> tuple[Any, ...]:
    return (*things[:which], thing, *things[which + 1 :])


def trouble_of(s: State) -> str:
    """Return which invariant does not hold."""
    both = (*s.olds, *s.news)
    got = s.got
    if _works(s.olds) and _works(s.news):
        trouble = "old and new are at work"
    elif len(set(got)) < len(got):
        trouble = "doubled"
    elif list(got) != sorted(got):
        trouble = "reordered"
    elif any(runs > 1 for _, runs in s.runs):
        trouble = "a call was run twice"
    elif any(one.phase != "work" and _has_chains(one) for one in both):
        trouble = "a chain is inside what is paused"
    elif s.spec == "old" and any(item % 1 for item in got):
        trouble = "what was not kept has spoken"
    elif s.round == "end" and is_quiet(s):
        missing = set(range(1, s.sent + 1)) - set(got) - s.excused
        trouble = "lost" if missing else ""
    else:
        trouble = ""
    return trouble


def visible(s: State) -> tuple[tuple[bool, bool], ...]:
    """Return what of a state `trouble_of` finds wrong, and a later state not."""
    both = (*s.olds, *s.news)
    return tuple((one.phase == "work", _has_chains(one)) for one in both)


def _has_chains(one: Incarnation) -> bool:
    return one.inside >= 0 or bool(one.outside)


def _works(ones: tuple[Incarnation, ...]) -> bool:
    return any(one.phase == "work" for one in ones)


def is_final(s: State, bounds: Bounds) -> bool:
    """Whether all is done: the move ended, all was sent, and all calls came back."""
    return (
        s.round == "end"
        and s.sent == bounds.messages
        and is_quiet(s)
        and all(where in {"answered", "error"} for where, _ in s.calls)
    )


def is_quiet(s: State) -> bool:
    """Whether one side works and nothing waits or is under way."""
    ones = s.all_of(s.spec)
    alive = not (s.is_source_dead or s.is_sink_dead)
    told = all(f"{s.spec} {which}" in s.told for which in range(len(ones)))
    settled = s.applied == s.spec and told and s.held is None and not s.late
    work = all(one.phase == "work" and not one.inbox for one in ones)
    return alive and settled and work and not any((*s.to_olds, *s.to_news))
