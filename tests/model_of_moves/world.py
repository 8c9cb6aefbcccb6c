"""The modelled world, and what must always hold in it."""

from __future__ import annotations

from typing import Any, NamedTuple

MARK = 0
"""A mark in a stream of messages, which are numbered from 1."""


class Bounds(NamedTuple):
    """How much happens in the model."""

    messages: int = 2
    callers: str = ""
    """A letter each: `c` calls, `r` is called back by what its callee calls."""
    kills: int = 0
    gives_up: int = 0
    killed: str = "SondD"
    """Containers that may be killed, by their letter."""


class Incarnation(NamedTuple):
    """The moved component in one container (`poise.runtime.runner.Runner`).

    `phase`: inactive, ready (activated, at rest), work, rest, gone, dead.
    """

    phase: str
    stays: bool = False
    is_retired: bool = False
    inside: int = -1
    """The caller whose chain is inside; -1: none."""
    inbox: tuple[int, ...] = ()
    log: tuple[int, ...] = ()
    """Its state: what it has worked on."""
    is_marked: bool = False


class State(NamedTuple):
    """All of the modelled world."""

    old: Incarnation
    new: Incarnation
    # the manager
    round: str = "shut"
    orders: tuple[tuple[str, str], ...] = ()
    """Orders of this round: name and outcome (sent, done, failed)."""
    stale: frozenset[str] = frozenset()
    """Orders that were given up and may still be taken."""
    spec: str = "both"
    """What agents were told: both, only old, only new."""
    told: frozenset[str] = frozenset()
    """The containers of the component that heard it."""
    # the source's outlet, and the streams between containers
    applied: str = "both"
    path: str = "old"
    held: tuple[int, ...] | None = None
    sent: int = 0
    is_source_dead: bool = False
    is_sink_marked: bool = False
    is_sink_dead: bool = False
    to_old: tuple[int, ...] = ()
    to_new: tuple[int, ...] = ()
    from_old: tuple[int, ...] = ()
    from_new: tuple[int, ...] = ()
    got: tuple[int, ...] = ()
    """What the sink received."""
    calls: tuple[tuple[str, str], ...] = ()
    """Each caller: where it is, and its path."""
    runs: tuple[int, ...] = ()
    """How often each call was run."""
    excused: frozenset[int] = frozenset()
    """Messages that were in a container when it was killed."""
    kills: int = 0
    given_up: int = 0


def changed(state: State, **changes: Any) -> State:
    """Return a state with some fields changed."""
    return state._replace(**changes)


def trouble_of(s: State) -> str:
    """Return which invariant does not hold."""
    both = s.old, s.new
    missing = set(range(1, s.sent + 1)) - set(s.got) - s.excused
    troubles = {
        "two are at work": s.old.phase == s.new.phase == "work",
        "doubled": len(set(s.got)) < len(s.got),
        "reordered": list(s.got) != sorted(s.got),
        "a call was run twice": any(runs > 1 for runs in s.runs),
        "a chain is inside what is at rest": any(
            one.inside >= 0 and one.phase != "work" for one in both
        ),
        "lost": bool(missing) and s.round == "end" and is_quiet(s),
    }
    return next((name for name, holds in troubles.items() if holds), "")


def is_final(s: State, bounds: Bounds) -> bool:
    """Whether all is done: the move ended, all was sent, and all calls came back."""
    return (
        s.round == "end"
        and s.sent == bounds.messages
        and is_quiet(s)
        and all(where in {"answered", "error"} for where, _ in s.calls)
    )


def is_quiet(s: State) -> bool:
    """Whether one incarnation works and nothing waits or is under way."""
    one: Incarnation = getattr(s, s.spec)
    streams = (s.to_old, s.to_new, s.from_old, s.from_new)
    alive = not (s.is_source_dead or s.is_sink_dead)
    settled = s.applied == s.spec in s.told and s.held is None and not s.stale
    return (
        alive and settled and one.phase == "work" and not one.inbox and not any(streams)
    )
