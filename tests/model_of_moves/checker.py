"""Explores every state of a model, and tells the shortest way to a bad one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import Generic, NamedTuple, TypeVar

S = TypeVar("S", bound=Hashable)

Successors = Callable[[S], Iterator[tuple[str, S]]]
"""Yields what may happen next: the name of the step, and the state after it."""


class Report(NamedTuple, Generic[S]):
    """What was found; `trouble` is empty when all is well.

    `way` names the steps from the initial state to the troubled one.
    """

    num_states: int
    trouble: str
    way: tuple[str, ...]


def explore(
    initial: S,
    successors: Successors[S],
    trouble_of: Callable[[S], str],
    is_final: Callable[[S], bool],
) -> Report[S]:
    """Look at every reachable state, nearest first.

    Parameters
    ----------
    trouble_of
        Returns what is wrong with a state; empty when nothing is.
    is_final
        Whether a state is an end: all is done, and nothing need happen any more.

    Returns
    -------
    A state with trouble; else one that is stuck before the end; else one from which no
    end can be reached; else none.
    """
    came_from: dict[S, tuple[S, str] | None] = {initial: None}
    before: dict[S, list[S]] = {}
    ends: list[S] = []
    waiting = deque([initial])
    while waiting:
        state = waiting.popleft()
        trouble = trouble_of(state)
        followers = () if trouble else tuple(successors(state))
        if is_final(state):
            ends.append(state)
        elif not trouble and not followers:
            trouble = f"stuck: {state}"
        if trouble:
            return Report(len(came_from), trouble, _way(came_from, state))
        for name, follower in followers:
            before.setdefault(follower, []).append(state)
            if follower not in came_from:
                came_from[follower] = (state, name)
                waiting.append(follower)
    lost = _first_without_end(came_from, before, ends)
    if lost is not None:
        return Report(len(came_from), f"no end: {lost}", _way(came_from, lost))
    return Report(len(came_from), "", ())


def _first_without_end(
    found: Iterable[S], before: dict[S, list[S]], ends: list[S]
) -> S | None:
    good, waiting = set(ends), list(ends)
    while waiting:
        for state in before.get(waiting.pop(), ()):
            if state not in good:
                good.add(state)
                waiting.append(state)
    return next((state for state in found if state not in good), None)


def _way(came_from: dict[S, tuple[S, str] | None], state: S) -> tuple[str, ...]:
    names: list[str] = []
    while (step := came_from[state]) is not None:
        state, name = step
        names.append(name)
    return tuple(reversed(names))
